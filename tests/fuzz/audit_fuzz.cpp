// SPDX-License-Identifier: Apache-2.0
//
// Goal: a program that looks at a system (agnocast-ctl) survives whatever it finds there: packets
// of a daemon of any shape, and regions in which hostile processes have stored any words. Method:
// a real Observer on a real socket. The other end sends what the input says: a dump that is more
// or less complete, with memfds as regions. Then one audit of it.
//   look      returns a system whose indexes are inside their tables, or a problem as text
//   audit     ends; every invariant that it names exists, and every place has a name

#include <ctl/snapshot/audit.hpp>
#include <ctl/snapshot/threads.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/sockets/packet_socket.hpp>

#include <tests/support/wire/listen_at.hpp>

#include <fuzzer/FuzzedDataProvider.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace {

using namespace agnocast;
namespace wire = abi::wire;
using wire::Opcode;

constexpr std::uint64_t region_bytes = std::uint64_t{16} << 20;

void require(bool condition) {
  if (!condition) std::abort();
}

struct Message {
  std::vector<std::byte> bytes;
  std::vector<UniqueFd> fds;
};

UniqueFd memory(std::uint64_t bytes) {
  UniqueFd fd(::memfd_create("fuzz", MFD_CLOEXEC));
  require(fd && ::ftruncate(fd.get(), static_cast<off_t>(bytes)) == 0);
  return fd;
}

/// The daemon's messages, and the content of the regions.
class Script {
 public:
  explicit Script(FuzzedDataProvider& input) : input_(input) {}

  std::vector<Message> dump() {
    add(daemon(), Opcode::dump_daemon);
    const int processes = input_.ConsumeIntegralInRange(0, 3);
    const int topics = input_.ConsumeIntegralInRange(0, 2);
    const int endpoints = input_.ConsumeIntegralInRange(0, 6);
    wire::DumpEnd end{};
    for (int i = 0; i < processes; ++i) add_process(static_cast<std::uint64_t>(i), end);
    for (int i = 0; i < topics; ++i) {
      wire::DumpTopic topic{};
      topic.topic = static_cast<std::uint32_t>(some(static_cast<std::uint64_t>(i)));
      topic.link_blocks = static_cast<std::uint32_t>(some(1));
      name(topic.name);
      name(topic.type);
      add(topic, Opcode::dump_topic);
      ++end.topic_count;
    }
    for (int i = 0; i < endpoints; ++i) {
      add(endpoint(), Opcode::dump_endpoint);
      ++end.endpoint_count;
    }
    if (input_.ConsumeBool()) {
      add(wire::DumpUser{}, Opcode::dump_user);
      ++end.user_count;
    }
    if (input_.ConsumeBool()) {
      wire::DumpRefusal refusal{};
      name(refusal.topic);
      name(refusal.why);
      add(refusal, Opcode::dump_refusal);
      ++end.refusal_count;
    }
    for (int i = input_.ConsumeIntegralInRange(0, 2); i > 0; --i) add_group(end);
    for (auto i = input_.ConsumeIntegralInRange<std::uint32_t>(0, 2); i > 0; --i)
      add_thread(i, end);
    add(end, Opcode::dump_end);
    return std::move(messages_);
  }

  UniqueFd board() {
    UniqueFd board = memory(abi::board_bytes);
    const std::uint64_t topic = abi::topic_offset(0);
    for (int i = input_.ConsumeIntegralInRange(0, 16); i > 0; --i)
      store(board.get(),
            topic + 8 * input_.ConsumeIntegralInRange<std::uint64_t>(0, abi::topic_bytes / 8 - 1));
    return board;
  }

 private:
  /// Returns mostly the usual value, sometimes any.
  std::uint64_t some(std::uint64_t usual) {
    return input_.ConsumeIntegralInRange(0, 15) == 0 ? input_.ConsumeIntegral<std::uint64_t>()
                                                     : usual;
  }
  void store(int fd, std::uint64_t at) {
    const std::uint64_t value = input_.ConsumeBool() ? input_.ConsumeIntegral<std::uint64_t>()
                                                     : input_.ConsumeIntegral<std::uint8_t>();
    require(::pwrite(fd, &value, sizeof value, static_cast<off_t>(at)) == sizeof value);
  }
  void name(wire::Name& name) {
    const std::string text = input_.ConsumeRandomLengthString(12);
    std::memcpy(name.text, text.data(), text.size());
    if (input_.ConsumeIntegralInRange(0, 15) == 0) std::memset(name.text, 'x', sizeof name.text);
  }
  wire::DumpDaemon daemon() {
    wire::DumpDaemon daemon{};
    daemon.arena_base = some(0x200000000000);
    daemon.arena_bytes = some(std::uint64_t{1} << 32);
    daemon.window_bytes = some(std::uint64_t{1} << 26);
    return daemon;
  }
  void add_process(std::uint64_t index, wire::DumpEnd& end) {
    wire::DumpProcess process{};
    process.client = some(index);
    process.generation = some(index + 1);
    process.state = static_cast<wire::ProcessState>(some(1));
    process.window_count = static_cast<std::uint32_t>(some(index + 1));
    for (std::uint64_t w = 0; w < abi::window_count_max; ++w) {
      process.window[w].base = some(0x200000000000 + ((index * 8 + w) << 26));
      process.window[w].bytes = some(std::uint64_t{1} << 26);
      process.window[w].first = some(0);
    }
    name(process.name);
    const bool has_region = input_.ConsumeIntegralInRange(0, 15) != 0;
    process.region_count = has_region ? 1 : 0;
    add(process, Opcode::dump_process, has_region ? region(index + 1) : UniqueFd());
    ++end.process_count;
  }
  UniqueFd region(std::uint64_t generation) {
    const bool is_short = input_.ConsumeIntegralInRange(0, 15) == 0;
    UniqueFd fd = memory(is_short ? input_.ConsumeIntegral<std::uint16_t>() : region_bytes);
    if (is_short) return fd;
    abi::ClientRegionHeader header{};
    header.magic.store(abi::client_region_magic);
    header.fingerprint.store(abi::fingerprint());
    header.generation.store(generation);
    require(::pwrite(fd.get(), static_cast<const void*>(&header), sizeof header, 0) ==
            sizeof header);
    for (int i = input_.ConsumeIntegralInRange(0, 40); i > 0; --i) {
      // The header, or the beginning of an extent, or anywhere in one.
      const std::uint64_t where = input_.ConsumeIntegralInRange<std::uint64_t>(0, 4);
      const std::uint64_t within =
          8 * (input_.ConsumeBool() ? input_.ConsumeIntegralInRange<std::uint64_t>(0, 63)
                                    : input_.ConsumeIntegralInRange<std::uint64_t>(0, 65535));
      store(fd.get(), where == 0 ? within % abi::page_bytes : extent(where - 1) + within);
    }
    return fd;
  }
  static std::uint64_t extent(std::uint64_t which) {
    return abi::page_bytes +
           which * ((abi::publisher_extent_bytes + abi::page_bytes - 1) & ~(abi::page_bytes - 1));
  }
  wire::DumpEndpoint endpoint() {
    wire::DumpEndpoint endpoint{};
    endpoint.kind = input_.ConsumeBool() ? wire::Kind::publisher : wire::Kind::subscription;
    endpoint.topic = static_cast<std::uint32_t>(some(0));
    endpoint.index = some(input_.ConsumeIntegralInRange<std::uint64_t>(0, 2));
    endpoint.generation = some(input_.ConsumeIntegralInRange<std::uint64_t>(1, 3));
    endpoint.board_word = some(abi::pack_board_word(endpoint.generation, abi::BoardState::active));
    endpoint.client = some(input_.ConsumeIntegralInRange<std::uint64_t>(0, 2));
    endpoint.client_generation = some(endpoint.client + 1);
    endpoint.extent = input_.ConsumeIntegralInRange(0, 15) == 0
                          ? input_.ConsumeIntegralInRange<std::uint64_t>(0, 2 * region_bytes)
                          : extent(input_.ConsumeIntegralInRange<std::uint64_t>(0, 3));
    endpoint.slot_count = some(input_.ConsumeIntegralInRange<std::uint64_t>(0, 3) * 128);
    endpoint.first_sequence = some(0);
    endpoint.quota = some(4);
    name(endpoint.node);
    return endpoint;
  }
  template <class Body>
  void choose_process(Body& body) {
    body.client = some(input_.ConsumeIntegralInRange<std::uint64_t>(0, 2));
    body.client_generation = some(body.client + 1);
  }
  void add_group(wire::DumpEnd& end) {
    wire::DumpCallbackGroup group{};
    choose_process(group);
    group.executor = some(0);
    group.group = some(1);
    group.reentrant = static_cast<std::uint32_t>(some(0));
    name(group.node);
    name(group.name);
    add(group, Opcode::dump_callback_group);
    ++end.callback_group_count;
  }
  void add_thread(std::uint32_t number, wire::DumpEnd& end) {
    constexpr std::uint32_t body_count = wire::thread_executor_count_max;
    wire::DumpCallbackThread thread{};
    choose_process(thread);
    thread.thread = static_cast<std::uint32_t>(some(number));
    const auto executors = input_.ConsumeIntegralInRange<std::uint32_t>(0, 2 * body_count + 1);
    thread.executor_count = static_cast<std::uint32_t>(some(executors));
    thread.setting = static_cast<wire::ThreadSetting>(some(2));
    thread.call = static_cast<wire::ThreadCall>(some(0));
    thread.os_errno = static_cast<std::uint32_t>(some(0));
    add(thread, Opcode::dump_callback_thread);
    ++end.callback_thread_count;
    // Sometimes too few bodies, or too many.
    const std::uint32_t sent = input_.ConsumeIntegralInRange(0, 15) == 0
                                   ? input_.ConsumeIntegralInRange<std::uint32_t>(0, 3 * body_count)
                                   : executors;
    for (std::uint32_t first = 0; first < sent; first += body_count) {
      wire::DumpThreadExecutors body{};
      for (std::uint32_t i = 0; i < body_count; ++i) body.executor[i] = first + i;
      body.executor[0] = some(first);
      add(body, Opcode::dump_thread_executors);
      ++end.thread_executors_count;
    }
  }
  template <class Body>
  void add(Body body, Opcode opcode, UniqueFd fd = {}) {
    body.header = {opcode, sizeof body, 1};
    std::vector<std::byte> bytes(sizeof body);
    std::memcpy(bytes.data(), &body, sizeof body);
    if (input_.ConsumeIntegralInRange(0, 63) == 0)  // another shape
      bytes.resize(input_.ConsumeIntegralInRange<std::size_t>(1, wire::packet_bytes_max));
    // In the previous packet, as the daemon does, or in a separate one.
    if (messages_.empty() ||
        messages_.back().bytes.size() + bytes.size() > wire::answer_bytes_max ||
        input_.ConsumeIntegralInRange(0, 3) == 0)
      messages_.emplace_back();
    Message& packet = messages_.back();
    packet.bytes.insert(packet.bytes.end(), bytes.begin(), bytes.end());
    if (fd) packet.fds.push_back(std::move(fd));
  }

  FuzzedDataProvider& input_;
  std::vector<Message> messages_;
};

const std::string& own_socket() {
  static const std::string path = "/tmp/agnocast-fuzz-" + std::to_string(::getpid());
  return path;
}

void serve(PacketListener& listener, const UniqueFd& board, const std::vector<Message>& messages) {
  Result<std::optional<PacketSocket>> accepted = std::optional<PacketSocket>();
  while (accepted && !*accepted) accepted = listener.accept();
  require(accepted.has_value());
  const PacketSocket& socket = **accepted;
  wire::Observed observed{};
  observed.header = {Opcode::observed, sizeof observed, 1};
  observed.client_region_bytes = region_bytes;
  const int board_fd = board.get();
  (void)socket.send(std::as_bytes(std::span(&observed, 1)), {&board_fd, 1}, Wait::yes);
  for (const Message& message : messages) {
    std::vector<int> fds;
    for (const UniqueFd& fd : message.fds) fds.push_back(fd.get());
    for (;;) {  // until it has read enough, or is gone
      const auto sent = socket.send(message.bytes, fds);
      if (!sent || *sent != Sent::would_block) break;
      std::this_thread::yield();
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static PacketListener* const listener = [] {
    ::unlink(own_socket().c_str());
    auto made = test::listen_at(own_socket());
    require(made.has_value());
    (void)std::atexit([] { ::unlink(own_socket().c_str()); });
    return new PacketListener(std::move(*made));
  }();
  FuzzedDataProvider input(data, size);
  Script script(input);
  const UniqueFd board = script.board();
  const std::vector<Message> messages = script.dump();
  std::thread daemon([&] { serve(*listener, board, messages); });
  {
    auto observer = ctl::Observer::connect(own_socket());
    require(observer.has_value());
    if (auto system = observer->look({.threads = true})) {
      ctl::Arguments everywhere;
      everywhere.all_domains = true;
      const auto threads = ctl::threads_of(*system, everywhere);
      require(threads.size() == system->callback_threads.size());
      for (const ctl::CallbackThread& thread : threads)
        require(thread.executors.size() == thread.facts->executor_count &&
                thread.groups.size() == thread.group_count);
      for (const auto& [index, topic] : system->topics) require(index < abi::topic_count_max);
      const ctl::Audit audit = ctl::audit(*system, observer->region_bytes());
      for (const ctl::Finding& finding : audit.findings)
        require(!finding.where.empty() && *journal::sentence_of(finding.invariant) != '\0');
    }
  }
  daemon.join();
  return 0;
}
