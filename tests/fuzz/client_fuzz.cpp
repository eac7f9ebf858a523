// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever agnocastd sends, and whatever other processes have stored in the memory that
// comes with it, a process that uses the library survives: no crash, and no unreadable message
// handed out. Method: the whole client, with its control thread and one subscription; this test is
// its daemon, on a real socket. An input is a few packets of any kind and shape, whose descriptors
// are as long as the packets say (only a daemon makes them), and words stored into the regions.
// Then the subscription takes what it finds. State from earlier inputs remains in the process. Not
// reached: publishers (a sanitized process has no heap hook), and whatever ends a session.

#include <client/session/context.hpp>

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/fingerprint.hpp>
#include <base/memory/mapping.hpp>
#include <region/views.hpp>

#include <tests/support/wire/listen_at.hpp>

#include <fuzzer/FuzzedDataProvider.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

namespace {

using namespace agnocast;
namespace wire = abi::wire;
using wire::Opcode;

constexpr std::uint64_t arena_base = 0x200000000000, arena_bytes = std::uint64_t{1} << 32;
constexpr std::uint64_t region_bytes = std::uint64_t{16} << 20,
                        window_bytes = std::uint64_t{1} << 20;
constexpr std::uint64_t message_bytes = 64;

void require(bool condition) {
  if (!condition) std::abort();
}
UniqueFd memory(std::uint64_t bytes) {
  UniqueFd fd(::memfd_create("fuzz", MFD_CLOEXEC));
  require(fd && ::ftruncate(fd.get(), static_cast<off_t>(bytes)) == 0);
  return fd;
}

void wait_for(int fd) {
  pollfd readable{fd, POLLIN, 0};
  int found = -1;
  do {
    found = ::poll(&readable, 1, 20'000);
  } while (found < 0 && errno == EINTR);  // interrupted by libFuzzer's clock
  require(found == 1);
}

/// The daemon of one client.
class Daemon {
 public:
  Daemon() {
    static const std::string path = "/tmp/agnocast-fuzz-client-" + std::to_string(::getpid());
    (void)std::atexit([] { ::unlink(path.c_str()); });
    ::unlink(path.c_str());
    auto listener = test::listen_at(path);
    require(listener.has_value());
    listener_ = std::move(*listener);
    ::setenv("AGNOCAST_SOCKET", path.c_str(), 1);
    board_ = memory(abi::board_bytes);
    region_ = memory(std::uint64_t{1} << 30);
    std::thread user([this] {
      EndpointRequest request;
      request.topic = "/fuzz";
      request.type = "tests/Fuzz";
      request.node = "/fuzz";
      request.qos.depth = 10;
      request.quota = 4;
      request.message_bytes = message_bytes;
      auto made = Context::instance().create_subscription(
          request, Context::instance().idle_wait_set().value());
      require(made.has_value());
      subscription_ = *made;
    });
    accept();
    while (!serve_one(Opcode::create_subscription)) {
    }
    user.join();
  }

  SubscriptionEndpoint& subscription() { return *subscription_; }

  template <class Body>
  void say(Opcode opcode, Body body, std::span<const int> fds = {}, std::uint64_t request = 0) {
    body.header = {opcode, sizeof body, request};
    (void)socket_.send(std::as_bytes(std::span(&body, 1)), fds, Wait::yes);
  }
  void say_bytes(const std::vector<std::byte>& bytes, std::span<const int> fds) {
    if (!bytes.empty()) (void)socket_.send(bytes, fds, Wait::yes);
  }
  /// Returns when the client has handled all earlier packets; it may have reconnected meanwhile.
  void await() {
    wire::Reference mark{};
    mark.kind = wire::Kind::subscription;
    mark.topic = ~0u;
    mark.index = ++marks_;
    say(Opcode::forget, mark);
    for (;;) {
      if (!receive()) {
        while (!serve_one(Opcode::rejoin)) {
        }
        return;
      }
      wire::Unlinked said{};
      if (packet_.header().opcode == Opcode::unlinked && packet_.read(said) && said.topic == ~0u &&
          said.index == marks_)
        return;
      answer();
    }
  }

 private:
  void accept() {
    Result<std::optional<PacketSocket>> next = std::optional<PacketSocket>();
    while (next && !*next) {
      wait_for(listener_.fd());
      next = listener_.accept();
    }
    require(next.has_value());
    socket_ = std::move(**next);
  }
  /// Returns false when the client has closed this connection and opened another.
  bool receive() {
    wait_for(socket_.fd());
    auto received = socket_.receive(packet_.bytes);
    if (!received || received->kind != Packet::Kind::data) {
      accept();
      return false;
    }
    packet_.size = received->bytes;
    packet_.packet = std::move(*received);
    return true;
  }
  bool serve_one(Opcode last) {
    if (!receive()) return false;
    answer();
    return packet_.header().opcode == last;
  }
  void answer() {
    const std::uint64_t request = packet_.header().request & ~wire::asked_again;
    switch (packet_.header().opcode) {
      case Opcode::hello: {
        wire::Welcome welcome{};
        welcome.fingerprint = abi::fingerprint();
        welcome.incarnation = 1;
        welcome.client = 0;
        welcome.client_generation = 1;
        welcome.arena_base = arena_base;
        welcome.arena_bytes = arena_bytes;
        welcome.client_region_bytes = abi::client_region_bytes;
        const int fds[] = {board_.get(), region_.get()};
        return say(Opcode::welcome, welcome, fds, request);
      }
      case Opcode::rejoin: {
        wire::Rejoined rejoined{};
        rejoined.incarnation = 1;
        return say(Opcode::rejoined, rejoined, {}, request);
      }
      case Opcode::open_wait_set: {
        const UniqueFd doorbell(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
        const UniqueFd datagram(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
        const int fds[] = {doorbell.get(), datagram.get()};
        return say(Opcode::wait_set_opened, wire::Done{}, fds, request);
      }
      case Opcode::create_subscription: {
        wire::EndpointCreated created{};
        created.generation = 1;
        created.extent = abi::page_bytes;
        const std::uint64_t word = abi::pack_board_word(1, abi::BoardState::active);
        const Mapping board =
            Mapping::map(board_.get(), abi::board_bytes, Mapping::Access::read_write).value();
        region::TopicWords<SharedMemory>{board.base(), abi::topic_offset(0)}
            .subscription(0, offsetof(abi::SubscriptionEntry, word))
            .store(word);
        return say(Opcode::endpoint_created, created, {}, request);
      }
      default:
        if (request > 1) say(Opcode::done, wire::Done{}, {}, request);
    }
  }

  PacketListener listener_;
  PacketSocket socket_;
  UniqueFd board_, region_;
  Incoming packet_;
  std::shared_ptr<SubscriptionEndpoint> subscription_;
  std::uint64_t marks_ = 0;
};

struct OneReceived final : Receiver {
  Received* place(Link&) noexcept override { return &received; }
  Received received;
};

class Script {
 public:
  Script(FuzzedDataProvider& input, Daemon& daemon) : input_(input), daemon_(daemon) {}

  void play() {
    for (int i = input_.ConsumeIntegralInRange(1, 8); i > 0; --i) say_something();
    daemon_.await();
    for (int i = 0; i < 20; ++i) {
      OneReceived one;
      const bool is_taken = daemon_.subscription().take(one);
      (void)daemon_.subscription().has_news();
      if (!is_taken) break;
      const Received& received = one.received;
      const auto* const message = reinterpret_cast<const std::byte*>(received.taken.address);
      std::byte copy[message_bytes];
      std::memcpy(copy, message, sizeof copy);  // a message that is handed out must be readable
      if (input_.ConsumeBool()) {
        received.release();
      } else {
        held_.push_back(received);
      }
    }
    for (const Received& received : held_) received.release();
    (void)daemon_.subscription().lost();
    (void)daemon_.subscription().publisher_count();
  }

 private:
  std::uint64_t some(std::uint64_t usual) {
    return input_.ConsumeIntegralInRange(0, 15) == 0 ? input_.ConsumeIntegral<std::uint64_t>()
                                                     : usual;
  }
  std::uint64_t few() { return some(input_.ConsumeIntegralInRange<std::uint64_t>(0, 4)); }
  wire::Kind kind() { return static_cast<wire::Kind>(few()); }
  std::uint32_t topic() { return static_cast<std::uint32_t>(some(0)); }

  // Long because each packet that a daemon may send has its branch.
  void say_something() {
    switch (input_.ConsumeIntegralInRange(0, 9)) {
      case 0:
      case 1:
      case 2:
        return say_announce();
      case 3: {
        wire::WindowAnnounced body{};
        body.client = few();
        body.client_generation = few();
        body.window = few();
        body.base = base(body.client, body.window);
        body.bytes = some(window_bytes);
        body.first = some(0);
        const UniqueFd fd = memory(std::max(window_bytes, std::min(body.bytes, arena_bytes)));
        return finish(Opcode::window_announced, body, {fd.get()});
      }
      case 4: {
        wire::Reference body{};
        body.kind = kind();
        body.topic = topic();
        body.index = few();
        body.generation = few();
        return finish(input_.ConsumeBool()   ? Opcode::forget
                      : input_.ConsumeBool() ? Opcode::kick
                                             : Opcode::region,
                      body);
      }
      case 5: {
        wire::Orphaned body{};
        body.topic = topic();
        body.index = few();
        body.generation = few();
        body.final_head = few();
        return finish(Opcode::orphaned, body);
      }
      case 6: {
        wire::Notice body{};
        body.code = static_cast<std::uint32_t>(some(static_cast<std::uint64_t>(
            input_.ConsumeBool() ? Errc::qos_incompatible : Errc::arena_occupied)));
        body.kind = kind();
        body.topic = topic();
        body.policy = static_cast<abi::QosPolicy>(few());
        body.index = few();
        body.generation = few();
        fill(body.text);
        return finish(Opcode::notice, body);
      }
      case 7: {
        wire::Own body{};
        body.kind = kind();
        body.topic = topic();
        body.index = few();
        body.generation = few();
        body.creation = few();
        body.active = input_.ConsumeBool();
        return finish(Opcode::own, body);
      }
      case 8: {  // an answer to no request, or to a past one
        wire::Refused body{};
        body.code = input_.ConsumeIntegral<std::uint32_t>();
        fill(body.text);
        request_ = 2 + few();
        return finish(Opcode::refused, body);
      }
      default: {
        auto bytes = input_.ConsumeBytes<std::byte>(
            input_.ConsumeIntegralInRange<std::size_t>(sizeof(wire::Header), 64));
        bytes.resize(std::max(bytes.size(), sizeof(wire::Header)));
        wire::Header header{};
        std::memcpy(&header, bytes.data(), sizeof header);
        if (header.opcode == Opcode::revoked) return;
        return finish_bytes(header.opcode, some(header.request), std::move(bytes), {});
      }
    }
  }

  void say_announce() {
    wire::Announcement body{};
    body.kind = static_cast<wire::Kind>(some(static_cast<std::uint64_t>(wire::Kind::publisher)));
    body.topic = topic();
    body.own_index = some(0);
    body.own_generation = some(1);
    body.index = few();
    body.generation = few();
    body.client = few();
    body.client_generation = few();
    // Extents come from the daemon.
    body.extent = abi::page_bytes * input_.ConsumeIntegralInRange<std::uint64_t>(1, 16);
    body.qos = abi::pack_qos({10, false, true, false, false});
    if (input_.ConsumeBool())
      body.qos = {input_.ConsumeIntegral<std::uint64_t>(), some(0), some(0), some(0)};
    body.first_sequence = some(0);
    body.wait_set = few() % abi::wait_set_count_max;
    body.from_start = input_.ConsumeBool();
    body.window_count = static_cast<std::uint32_t>(some(1));
    body.doorbell_count = static_cast<std::uint32_t>(few());
    body.quota = 4;
    for (std::uint64_t w = 0; w < abi::window_count_max; ++w) {
      body.window[w].base = base(body.client, w);
      body.window[w].bytes = some(window_bytes);
      body.window[w].first = some(0);
    }
    std::vector<UniqueFd> files;
    files.push_back(region(body));
    for (std::uint64_t w = 0; w < std::min<std::uint64_t>(body.window_count, 8); ++w)
      files.push_back(memory(std::max(window_bytes, std::min(body.window[w].bytes, arena_bytes))));
    std::vector<int> fds;
    for (const UniqueFd& file : files) fds.push_back(file.get());
    if (input_.ConsumeIntegralInRange(0, 15) == 0) fds.pop_back();
    finish(Opcode::announce, body, fds);
  }
  std::uint64_t base(std::uint64_t client, std::uint64_t window) {
    return some(arena_base + (client % 8 * 8 + window % 8) * window_bytes);
  }
  /// The region of another process: header, queue, with any content.
  UniqueFd region(const wire::Announcement& body) {
    UniqueFd fd = memory(region_bytes);
    const auto store = [&](std::uint64_t at, std::uint64_t value) {
      require(::pwrite(fd.get(), &value, sizeof value, static_cast<off_t>(at)) == 8);
    };
    using Header = abi::ClientRegionHeader;
    for (std::uint64_t w = 0; w < abi::window_count_max; ++w) {
      const std::uint64_t at = offsetof(Header, window) + w * sizeof(abi::WindowEntry);
      if (w < some(1)) store(at + offsetof(abi::WindowEntry, base), body.window[w].base);
      store(at + offsetof(abi::WindowEntry, frontier), some(window_bytes));
    }
    using Queue = abi::PublisherEndpoint;
    const std::uint64_t count = input_.ConsumeIntegralInRange<std::uint64_t>(0, 12);
    store(body.extent + offsetof(Queue, head), some(abi::pack_entry(count, count % 8)));
    for (std::uint64_t n = 1; n <= count; ++n) {
      const std::uint64_t slot = some(n % 8) % abi::slot_count_max;
      store(body.extent + abi::order_offset(n % SharedMemory::ring_count()),
            some(abi::pack_entry(n, slot)));
      const std::uint64_t at = body.extent + abi::slot_offset(SharedMemory::ring_count(), slot);
      store(at + offsetof(abi::QueueSlot, id), some(n));
      store(at + offsetof(abi::QueueSlot, address), some(body.window[0].base + n * message_bytes));
      store(at + offsetof(abi::QueueSlot, size), some(message_bytes));
      store(at + offsetof(abi::QueueSlot, stamp_ns), few());
    }
    for (int i = input_.ConsumeIntegralInRange(0, 8); i > 0; --i)
      store(8 * input_.ConsumeIntegralInRange<std::uint64_t>(0, 65535),
            input_.ConsumeIntegral<std::uint64_t>());
    return fd;
  }
  void fill(wire::Name& name) {
    const auto bytes = input_.ConsumeBytes<char>(sizeof name.text);
    std::copy(bytes.begin(), bytes.end(), name.text);
  }
  template <class Body>
  void finish(Opcode opcode, Body body, const std::vector<int>& fds = {}) {
    std::vector<std::byte> bytes(sizeof body);
    std::memcpy(bytes.data(), static_cast<const void*>(&body), sizeof body);
    if (input_.ConsumeIntegralInRange(0, 31) == 31)  // another shape
      bytes.resize(
          input_.ConsumeIntegralInRange<std::size_t>(sizeof(wire::Header), wire::packet_bytes_max));
    finish_bytes(opcode, std::exchange(request_, 0), std::move(bytes), fds);
  }
  void finish_bytes(Opcode opcode, std::uint64_t request, std::vector<std::byte> bytes,
                    const std::vector<int>& fds) {
    // A wrong length ends the connection, and reconnecting takes time.
    const bool is_wrong = input_.ConsumeIntegralInRange(0, 255) == 255;
    const wire::Header header{opcode, static_cast<std::uint32_t>(bytes.size() + is_wrong), request};
    std::memcpy(bytes.data(), &header, sizeof header);
    daemon_.say_bytes(bytes, fds);
  }

  FuzzedDataProvider& input_;
  Daemon& daemon_;
  std::vector<Received> held_;
  std::uint64_t request_ = 0;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static Daemon* const daemon = new Daemon;  // immortal, like the context
  FuzzedDataProvider input(data, size);
  Script(input, *daemon).play();
  return 0;
}
