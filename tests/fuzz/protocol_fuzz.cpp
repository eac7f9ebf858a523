// SPDX-License-Identifier: Apache-2.0
//
// Goal: no sequence of packets, deaths and stores of clients into their own regions brings the
// daemon's state machine into a state that is wrong.
// Method: the input is a list of steps of five processes of two users. Each packet goes through
// decode() and on to registry, membership and reaper over real regions; only sockets are missing. An
// oracle beside it knows nothing but the packets: what each process was told and has not let go of.
//   rule RU   no place, extent, process index or window is given out while somebody who was told of the
//             former one has not let go of it
//   board     says of every endpoint what the tables say
//   restart   a registry opened on the memory finds the same as the one that wrote it
//   rejoin    a process that lost its connection and has come back is told what it was told before
// Invariants of the daemon's own abort in it.

#include <agnocast/abi/fingerprint.hpp>
#include <daemon/address_plan.hpp>
#include <daemon/membership.hpp>
#include <daemon/reaper.hpp>

#include <fuzzer/FuzzedDataProvider.h>

#include <unistd.h>
#include <algorithm>
#include <array>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace {

using namespace agnocast;
using namespace agnocast::daemon;
using wire::Kind;
using wire::Opcode;

void require_that(bool condition, const char* what, int line) {
  if (condition) return;
  std::fprintf(stderr, "fuzz_protocol: not true: %s (line %d)\n", what, line);
  std::abort();
}
#define REQUIRE(condition) require_that((condition), #condition, __LINE__)

constexpr std::uint64_t window_bytes = 2 << 20, window_count = 8;

struct Range {
  std::uint64_t from = 0, to = 0;
  bool meets(const Range& other) const { return from < other.to && other.from < to; }
};
Range extent_of(Kind kind, std::uint64_t at) {
  return {at, at + (kind == Kind::publisher ? abi::publisher_extent_bytes
                                            : abi::subscription_extent_bytes)};
}

/// What one process was told of and has not let go of, from the packets alone.
struct Told {
  std::uint64_t packet = 0, generation = 0;
  std::uint64_t owner = 0;  // client
  Range extent;             // in the owner's region
  abi::Qos qos;
};
struct Endpoint {
  Kind kind = Kind::publisher;
  std::uint32_t topic = 0;
  std::uint64_t index = 0, generation = 0;
  Range extent;
  abi::Qos qos;
  std::uint64_t creation = 0;  // id of the request
  bool left = false;
};

struct Process {
  std::unique_ptr<Session> session;
  std::optional<ClientIndex> client;
  std::uint64_t generation = 0;
  std::uint32_t uid = 0;
  std::map<std::tuple<std::uint32_t, std::uint32_t, std::uint64_t>, Told>
      told;                                             // kind, topic, index
  std::map<std::uint64_t, Told> regions;                // by client
  std::map<std::uint64_t, std::vector<Range>> windows;  // by client
  std::vector<Endpoint> own;
  std::set<std::uint64_t> drained;  // generations that were its own
};

/// For the bells of executors; removed at the end.
struct BellsDirectory {
  BellsDirectory() {
    if (::mkdtemp(text) == nullptr) std::abort();
  }
  ~BellsDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(text, ignored);
  }
  char text[32] = "/tmp/agnocast-fuzz-XXXXXX";
};
std::string bells_directory() {
  static const BellsDirectory directory;
  return directory.text;
}

class Plane : public Post {
  static constexpr Capacity capacity{8, 4, 6, 8, abi::slot_count_max};

 public:
  explicit Plane(FuzzedDataProvider& input)
      : input_(input),
        regions_(std::move(Regions::create(store_).value())),
        registry_(regions_.memory(), capacity),
        plan_(Arena{std::uint64_t{1} << 45, window_count * window_bytes, window_bytes}),
        doorbells_(bells_directory(), store_),
        membership_(registry_, regions_, doorbells_, *this) {
    registry_.create(1);
    membership_.on_ended = [this](ClientIndex client) {
      regions_.close_client(client);
      const ClientRecord& record = registry_.client(client);
      for (std::uint64_t w = 0; w < record.window_count; ++w)
        REQUIRE(plan_.give_back(record.window[w].base));
    };
  }

  void run() {
    for (int step = 0; step < 300 && input_.remaining_bytes() > 0; ++step) {
      Process& process =
          processes_[input_.ConsumeIntegralInRange<std::size_t>(0, processes_.size() - 1)];
      switch (input_.ConsumeIntegralInRange(0, 31)) {
        case 0:
          die(process);
          break;
        case 1:
          if (process.client) scribble(process);
          break;
        case 2:
          // The connection ends, the process does not.
          if (process.client) process.session.reset();
          break;
        default:
          say(process);
          break;
      }
      check_board();
    }
    check_restart();
    for (Process& process : processes_) die(process);
    // Nobody is left, so nothing is.
    for (std::uint32_t c = 0; c < registry_.client_high(); ++c)
      REQUIRE(registry_.client(ClientIndex{c}).state == ClientState::free);
    for (std::uint32_t t = 0; t < registry_.topic_high(); ++t)
      REQUIRE(registry_.topic(TopicIndex{t}).state == TopicState::free);
    REQUIRE(plan_.used_count() == 0);
  }

  // --- Post
  Session* session_of(ClientIndex client) override {
    Process* const process = process_of(client);
    return process == nullptr ? nullptr : process->session.get();
  }
  std::uint64_t user_namespace_of(ClientIndex) override { return 1; }
  void send(ClientIndex client, std::span<const std::byte> bytes,
            std::vector<SharedFd> fds) override {
    Process* const process = process_of(client);
    if (process != nullptr && process->session) reply(*process, bytes, std::move(fds));
  }

 private:
  Process* process_of(ClientIndex client) {
    for (Process& process : processes_) {
      if (process.client == client) return &process;
    }
    return nullptr;
  }

  template <class Body>
  static Body read(std::span<const std::byte> bytes) {
    REQUIRE(bytes.size() == sizeof(Body));
    Body body;
    std::memcpy(static_cast<void*>(&body), bytes.data(), sizeof body);
    return body;
  }

  void reply(Process& to, std::span<const std::byte> bytes, std::vector<SharedFd> fds) {
    wire::Header header;
    std::memcpy(&header, bytes.data(), sizeof header);
    REQUIRE(header.bytes == bytes.size() && bytes.size() <= wire::packet_bytes_max);
    REQUIRE(fds.size() <= wire::descriptor_count_max);
    for (const SharedFd& fd : fds) REQUIRE(fd != nullptr && fd->get() >= 0);
    const std::size_t fd_count = fds.size();
    const std::uint64_t number = to.session->push(bytes, std::move(fds));
    to.session->drop_output();
    switch (header.opcode) {
      case Opcode::announce:
        on_announce(to, read<wire::Announcement>(bytes), number, fd_count);
        break;
      case Opcode::window_announced: {
        const auto body = read<wire::WindowAnnounced>(bytes);
        REQUIRE(fd_count == 1);
        REQUIRE(to.regions.count(body.client) == 1);
        to.regions[body.client].packet = number;
        to.windows[body.client].push_back({body.base, body.base + body.bytes});
        break;
      }
      case Opcode::endpoint_created:
        created_ = read<wire::EndpointCreated>(bytes);
        break;
      case Opcode::done:
        done_ = true;
        break;
      case Opcode::region: {
        const auto body = read<wire::Reference>(bytes);
        REQUIRE(body.kind == Kind::region);
        to.regions[body.index] = {number, body.generation, body.index, {}, {}};
        break;
      }
      case Opcode::own: {
        const auto body = read<wire::Own>(bytes);
        const auto known = std::find_if(
            to.own.begin(), to.own.end(),
            [&](const Endpoint& endpoint) { return endpoint.generation == body.generation; });
        if (known == to.own.end()) {
          // Drained, and somebody else has not let go yet: its process says so once more.
          REQUIRE(to.drained.count(body.generation) == 1 && body.active == 0);
          break;
        }
        REQUIRE(known->creation == body.creation && known->left == (body.active == 0));
        ++own_said_;
        break;
      }
      case Opcode::forget: {
        const auto body = read<wire::Reference>(bytes);
        REQUIRE(body.kind == Kind::subscription);
        break;
      }
      default:
        break;
    }
  }

  void on_announce(Process& to, const wire::Announcement& body, std::uint64_t number,
                   std::size_t fd_count) {
    const bool publisher = body.kind == Kind::publisher;
    REQUIRE(fd_count == 1 + (publisher ? body.window_count : body.doorbell_count));
    const Told told{number, body.generation, body.client, extent_of(body.kind, body.extent),
                    abi::unpack_qos(body.qos)};
    auto& place = to.told[{static_cast<std::uint32_t>(body.kind), body.topic, body.index}];
    REQUIRE(place.generation == 0 || place.generation == body.generation);
    place = told;
    auto& region = to.regions[body.client];
    REQUIRE(region.generation == 0 || region.generation == body.client_generation);
    region = {number, body.client_generation, body.client, {}, {}};
    if (publisher) {
      auto& windows = to.windows[body.client];
      windows.clear();
      for (std::uint32_t w = 0; w < body.window_count; ++w)
        windows.push_back({body.window[w].base, body.window[w].base + body.window[w].bytes});
    }
    // It is for an endpoint of the addressed process, and that one matches.
    const auto own = std::find_if(to.own.begin(), to.own.end(), [&](const Endpoint& endpoint) {
      return endpoint.generation == body.own_generation;
    });
    if (own != to.own.end()) {  // one that is being created is not in the list yet
      REQUIRE(own->topic == body.topic && own->index == body.own_index && own->kind != body.kind);
      REQUIRE(publisher ? abi::qos_match(told.qos, own->qos) : abi::qos_match(own->qos, told.qos));
    }
  }

  // --- what a process says

  template <class Body>
  void serve(Process& from, Opcode opcode, Body body, std::uint64_t id = 0) {
    body.header = {opcode, sizeof body, id != 0 ? id : ++last_request_};
    // As if it were not known whether the first one had arrived.
    if (input_.ConsumeIntegralInRange(0, 15) == 0) body.header.request |= wire::asked_again;
    serve_bytes(from, std::as_bytes(std::span(&body, 1)), {});
  }

  void serve_bytes(Process& from, std::span<const std::byte> packet, const Envelope& envelope) {
    if (from.client && !from.session) return rejoin(from);
    if (!from.session) {
      from.session = std::make_unique<Session>(PacketSocket(), PeerIdentity{});
      from.uid = static_cast<std::uint32_t>(&from - processes_.data()) % 2;
    }
    created_ = {};
    done_ = false;
    const Request request = decode(packet, envelope, from.session->role());
    if (const auto* const hello = std::get_if<wire::Hello>(&request)) {
      greet(from, *hello);
    } else if (const auto* const window = std::get_if<wire::WindowRequest>(&request)) {
      open_window(from, window->window);
    } else if (const auto* const executor = std::get_if<ExecutorRequest>(&request)) {
      if (!doorbells_.is_open(*from.client, executor->executor) &&
          doorbells_.open(*from.client, executor->executor))
        registry_.open_executor(*from.client, static_cast<std::uint32_t>(executor->executor));
    } else if (const auto* const create = std::get_if<CreateRequest>(&request)) {
      this->create(from, *create);
    } else if (const auto* const leave = std::get_if<LeaveRequest>(&request)) {
      const auto answer = membership_.leave(*from.client, *leave);
      REQUIRE(answer.has_value() == done_);
      if (answer) {
        Endpoint* const left = own_of(from, leave->reference);
        REQUIRE(leave->again || (left != nullptr && !left->left));
        if (left != nullptr) left->left = true;
      }
    } else if (const auto* const drained = std::get_if<DrainedRequest>(&request)) {
      this->drained(from, *drained);
    } else if (const auto* const unlinked = std::get_if<wire::Unlinked>(&request)) {
      this->unlinked(from, *unlinked);
    }
  }

  // docs/control-plane.md, coming back.
  void rejoin(Process& from) {
    from.session = std::make_unique<Session>(PacketSocket(), PeerIdentity{});
    from.session->greet(*from.client);
    registry_.note_rejoined(*from.client);
    auto packet = make_body<wire::Rejoined>(Opcode::rejoined, ++last_request_);
    reply(from, packet_of(packet), {});
    for (auto& [subject, told] : from.told) told.packet = 0;
    for (auto& [owner, told] : from.regions) told.packet = 0;
    own_said_ = 0;
    membership_.welcome_back(*from.client);
    REQUIRE(own_said_ == from.own.size());
    // Of its own region a process is told with its endpoints alone.
    for (const auto& [owner, told] : from.regions)
      REQUIRE(told.packet != 0 || owner == number(*from.client));
  }

  void greet(Process& from, const wire::Hello& hello) {
    if (hello.fingerprint != abi::fingerprint()) return;
    std::string_view name;
    REQUIRE(text_of(hello.process_name, name));
    const auto client = registry_.add_client({from.uid, from.uid, 1, hello.domain, name});
    if (!client) return;
    REQUIRE(regions_.open_client(*client, registry_.client(*client).generation).has_value());
    for (const Process& process : processes_) {
      if (process.client) REQUIRE(process.regions.count(number(*client)) == 0);
    }
    from.session->greet(*client);
    from.client = *client;
    from.generation = registry_.client(*client).generation;
  }

  void open_window(Process& from, std::uint64_t window) {
    const ClientRecord& record = registry_.client(*from.client);
    if (window != record.window_count || window >= abi::window_count_max) return;
    const auto choice = plan_.take();
    if (!choice) return;
    const Range range{choice->base, choice->base + window_bytes};
    for (const Process& process : processes_) {
      for (const auto& [owner, windows] : process.windows) {
        for (const Range& other : windows) REQUIRE(!process.client || !range.meets(other));
      }
    }
    REQUIRE(regions_.open_window(*from.client, window_bytes).has_value());
    registry_.open_window(*from.client, {choice->base, window_bytes, 0});
    membership_.announce_window(*from.client);
  }

  void create(Process& from, const CreateRequest& request) {
    for (const Endpoint& endpoint : from.own) {
      if (endpoint.creation != request.request || endpoint.kind != request.kind) continue;
      if (!request.again) return;  // no client uses an id twice
      if (endpoint.left) return;
      REQUIRE(membership_.answer_again(*from.client, request));
      REQUIRE(created_.generation == endpoint.generation && created_.index == endpoint.index);
      return;
    }
    if (request.again) REQUIRE(!membership_.answer_again(*from.client, request));
    if (!membership_.create(*from.client, request)) {
      REQUIRE(created_.generation == 0);
      return;
    }
    REQUIRE(created_.generation > last_generation_);
    last_generation_ = created_.generation;
    const Range extent = extent_of(request.kind, created_.extent);
    REQUIRE(extent.from >= abi::page_bytes && extent.to <= Registry::client_region_bytes);
    for (const Process& process : processes_) {
      if (!process.client) continue;
      for (const auto& [subject, told] : process.told) {
        if (subject ==
            std::tuple{static_cast<std::uint32_t>(request.kind), created_.topic, created_.index})
          REQUIRE(told.generation == created_.generation);
        if (told.generation != created_.generation && told.owner == number(*from.client))
          REQUIRE(!told.extent.meets(extent));
      }
    }
    for (const Endpoint& other : from.own) REQUIRE(!other.extent.meets(extent));
    from.own.push_back({request.kind, created_.topic, created_.index, created_.generation, extent,
                        request.qos, request.request, false});
  }

  Endpoint* own_of(Process& from, const wire::Reference& reference) {
    for (Endpoint& endpoint : from.own) {
      if (endpoint.kind == reference.kind && endpoint.topic == reference.topic &&
          endpoint.index == reference.index && endpoint.generation == reference.generation)
        return &endpoint;
    }
    return nullptr;
  }

  // docs/control-plane.md, leaving: of what else a `drained` speaks.
  void drained(Process& from, const DrainedRequest& request) {
    if (!membership_.drained(*from.client, request)) {
      REQUIRE(!done_);
      return;
    }
    REQUIRE(done_);
    Endpoint* const gone = own_of(from, request.reference);
    if (request.again && gone == nullptr) return;
    REQUIRE(gone != nullptr && gone->left);
    const Endpoint endpoint = *gone;
    from.drained.insert(endpoint.generation);
    from.own.erase(from.own.begin() + (gone - from.own.data()));
    const Kind others = endpoint.kind == Kind::publisher ? Kind::subscription : Kind::publisher;
    for (auto at = from.told.begin(); at != from.told.end();) {
      const auto [kind, topic, index] = at->first;
      bool over = kind == static_cast<std::uint32_t>(others) && topic == endpoint.topic;
      for (const Endpoint& other : from.own) {
        if (!over || other.topic != endpoint.topic || other.kind != endpoint.kind) continue;
        over = others == Kind::publisher ? !abi::qos_match(at->second.qos, other.qos) : false;
      }
      at = over ? from.told.erase(at) : std::next(at);
    }
  }

  void unlinked(Process& from, const wire::Unlinked& statement) {
    const bool accepted = membership_.unlinked(*from.client, statement).has_value();
    if (!accepted) return;
    if (statement.kind == Kind::region) {
      const auto found = from.regions.find(statement.index);
      if (found == from.regions.end() || found->second.generation != statement.generation ||
          found->second.packet > statement.seen)
        return;
      from.regions.erase(found);
      from.windows.erase(statement.index);
      return;
    }
    const auto found = from.told.find(
        {static_cast<std::uint32_t>(statement.kind), statement.topic, statement.index});
    if (found != from.told.end() && found->second.generation == statement.generation &&
        found->second.packet <= statement.seen)
      from.told.erase(found);
  }

  void say(Process& process) {
    if (!process.client && !rarely()) {  // nothing else would get far
      wire::Hello body{};
      body.fingerprint = abi::fingerprint();
      body.domain = rarely() ? 1 : 0;
      serve(process, Opcode::hello, body);
      return serve(process, Opcode::open_executor, wire::ExecutorRequest{});
    }
    switch (input_.ConsumeIntegralInRange(0, 15)) {
      case 0: {  // anything at all
        const auto bytes = input_.ConsumeBytes<std::uint8_t>(
            input_.ConsumeIntegralInRange<std::size_t>(0, wire::packet_bytes_max));
        serve_bytes(
            process, std::as_bytes(std::span(bytes)),
            {input_.ConsumeIntegralInRange<std::size_t>(0, 2), input_.ConsumeBool(), false});
        break;
      }
      case 1: {  // right in length and opcode
        constexpr std::pair<Opcode, std::size_t> packets[] = {
            {Opcode::open_window, sizeof(wire::WindowRequest)},
            {Opcode::open_executor, sizeof(wire::ExecutorRequest)},
            {Opcode::create_publisher, sizeof(wire::CreateEndpoint)},
            {Opcode::create_subscription, sizeof(wire::CreateEndpoint)},
            {Opcode::leave, sizeof(wire::Reference)},
            {Opcode::drained, sizeof(wire::Reference)},
            {Opcode::unlinked, sizeof(wire::Unlinked)},
            {Opcode::hello, sizeof(wire::Hello)}};
        const auto [opcode, size] =
            packets[input_.ConsumeIntegralInRange<std::size_t>(0, std::size(packets) - 1)];
        std::vector<std::byte> packet(size);
        const auto body = input_.ConsumeBytes<std::uint8_t>(size - sizeof(wire::Header));
        std::transform(body.begin(), body.end(), packet.begin() + sizeof(wire::Header),
                       [](std::uint8_t byte) { return std::byte{byte}; });
        const wire::Header header{opcode, static_cast<std::uint32_t>(size), ++last_request_};
        std::memcpy(packet.data(), &header, sizeof header);
        serve_bytes(process, packet, {});
        break;
      }
      case 2: {
        wire::Hello body{};
        body.fingerprint = abi::fingerprint();
        serve(process, Opcode::hello, body);
        break;
      }
      case 3: {
        wire::WindowRequest body{};
        body.window = input_.ConsumeIntegralInRange<std::uint64_t>(0, 3);
        serve(process, Opcode::open_window, body);
        break;
      }
      case 4: {
        wire::ExecutorRequest body{};
        body.executor = input_.ConsumeIntegralInRange<std::uint64_t>(0, 1);
        serve(process, Opcode::open_executor, body);
        break;
      }
      case 5:
      case 6:
      case 7: {
        wire::CreateEndpoint body{};
        const abi::Qos qos{input_.ConsumeIntegralInRange(1u, abi::depth_max), rarely(), !rarely(),
                           rarely(), false};
        body.qos = abi::pack_qos(qos);
        body.layout_hash = rarely() ? 2 : 1;
        body.executor = rarely() ? 1 : 0;
        body.quota = input_.ConsumeIntegralInRange<std::uint64_t>(1, 800);
        const bool publisher = input_.ConsumeBool();
        body.topic = name_of("/" + std::to_string(input_.ConsumeIntegralInRange(0, 1)));
        body.type = name_of("type");
        std::uint64_t id = 0;
        if (!process.own.empty() && input_.ConsumeIntegralInRange(0, 15) == 0)
          id = process.own.back().creation;
        serve(process, publisher ? Opcode::create_publisher : Opcode::create_subscription, body,
              id);
        break;
      }
      case 8:
      case 9:
      case 10:
      case 11: {
        // Mostly its own, now and then somebody else's.
        Process& whose = rarely() ? other() : process;
        if (whose.own.empty()) break;
        const Endpoint& about =
            whose.own[input_.ConsumeIntegralInRange<std::size_t>(0, whose.own.size() - 1)];
        wire::Reference body{};
        body.kind = about.kind;
        body.topic = about.topic;
        body.index = about.index;
        body.generation = about.generation;
        serve(process, about.left != rarely() ? Opcode::drained : Opcode::leave, body);
        break;
      }
      case 12:
      case 13:
      case 14: {
        Process& whose = rarely() ? other() : process;
        if (whose.told.empty() || !process.session) break;
        auto about = whose.told.begin();
        std::advance(about, input_.ConsumeIntegralInRange<std::ptrdiff_t>(
                                0, static_cast<std::ptrdiff_t>(whose.told.size()) - 1));
        const auto [kind, topic, index] = about->first;
        say_unlinked(process, Kind{kind}, topic, index, about->second.generation);
        break;
      }
      default: {
        if (process.regions.empty() || !process.session) break;
        auto about = process.regions.begin();
        std::advance(about, input_.ConsumeIntegralInRange<std::ptrdiff_t>(
                                0, static_cast<std::ptrdiff_t>(process.regions.size()) - 1));
        say_unlinked(process, Kind::region, 0, about->first, about->second.generation);
        break;
      }
    }
  }

  bool rarely() { return input_.ConsumeIntegralInRange(0, 7) == 0; }

  Process& other() {
    return processes_[input_.ConsumeIntegralInRange<std::size_t>(0, processes_.size() - 1)];
  }

  void say_unlinked(Process& process, Kind kind, std::uint32_t topic, std::uint64_t index,
                    std::uint64_t generation) {
    wire::Unlinked body{};
    body.kind = kind;
    body.topic = topic;
    body.index = index;
    body.generation = generation;
    const std::uint64_t sent = process.session->packet_count();
    body.seen = sent -
                std::min<std::uint64_t>(sent, input_.ConsumeIntegralInRange<std::uint64_t>(0, 3)) +
                (input_.ConsumeIntegralInRange(0, 31) == 0 ? 2 : 0);
    serve(process, Opcode::unlinked, body);
  }

  /// Any word into its own endpoints: what recovery reads at its death.
  void scribble(Process& process) {
    if (process.own.empty()) return;
    const Endpoint& where =
        process.own[input_.ConsumeIntegralInRange<std::size_t>(0, process.own.size() - 1)];
    for (int i = input_.ConsumeIntegralInRange(1, 4); i > 0; --i) {
      const std::uint64_t word = input_.ConsumeIntegralInRange<std::uint64_t>(0, 31);
      SharedMemory::word(regions_.region(*process.client), where.extent.from + word * 8)
          .store(input_.ConsumeBool() ? input_.ConsumeIntegral<std::uint64_t>()
                                      : input_.ConsumeIntegral<std::uint8_t>());
    }
  }

  void die(Process& process) {
    const auto client = process.client;
    process = Process{};
    if (client)
      static_cast<void>(
          reap(*client, journal::DeathReason::died, registry_, regions_, doorbells_, membership_));
  }

  void check_restart() {
    Registry later(regions_.memory(), capacity);
    REQUIRE(static_cast<bool>(later.open()));
    for (std::uint32_t c = 0; c < registry_.client_high(); ++c) {
      auto before = registry_.endpoints_of(ClientIndex{c}),
           after = later.endpoints_of(ClientIndex{c});
      const auto less = [](const EndpointRef& a, const EndpointRef& b) {
        return std::tuple(a.kind, a.topic, a.index) < std::tuple(b.kind, b.topic, b.index);
      };
      std::sort(before.begin(), before.end(), less);
      std::sort(after.begin(), after.end(), less);
      REQUIRE(before == after);
    }
  }

  void check_board() {
    for (std::uint32_t t = 0; t < registry_.topic_high(); ++t) {
      const TopicIndex topic{t};
      if (registry_.topic(topic).state == TopicState::free) continue;
      const dataplane::TopicWords<SharedMemory> words{regions_.memory().board,
                                                      abi::topic_offset(t)};
      for (std::uint32_t i = 0; i < registry_.topic(topic).publisher_high; ++i) {
        const PublisherRecord& record = registry_.publisher(topic, i);
        const auto state = abi::state_of(words.publisher(i, 0).load());
        REQUIRE(state == (record.state == EndpointState::active   ? abi::MemberState::active
                          : record.state == EndpointState::orphan ? abi::MemberState::orphan
                                                                  : abi::MemberState::free));
        REQUIRE(record.state == EndpointState::free ||
                abi::generation_of(words.publisher(i, 0).load()) == record.generation);
      }
      for (std::uint32_t i = 0; i < registry_.topic(topic).subscription_high; ++i) {
        const SubscriptionRecord& record = registry_.subscription(topic, i);
        const auto state = abi::state_of(words.subscription(i, 0).load());
        REQUIRE(state == (record.state == EndpointState::active    ? abi::MemberState::active
                          : record.state == EndpointState::leaving ? abi::MemberState::leaving
                          : record.state == EndpointState::dead    ? abi::MemberState::dead
                                                                   : abi::MemberState::free));
      }
    }
  }

  FuzzedDataProvider& input_;
  DescriptorStore store_;
  Regions regions_;
  Registry registry_;
  AddressPlan plan_;
  Doorbells doorbells_;
  Membership membership_;
  std::array<Process, 5> processes_;
  wire::EndpointCreated created_{};
  bool done_ = false;
  std::size_t own_said_ = 0;
  std::uint64_t last_request_ = 0, last_generation_ = 0;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzedDataProvider input(data, size);
  Plane plane(input);
  plane.run();
  return 0;
}
