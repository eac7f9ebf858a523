// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/system.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <agnocast/error.hpp>
#include <base/sockets/daemon_socket.hpp>
#include <base/text/text.hpp>
#include <ctl/snapshot/proc_files.hpp>

#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <iterator>
#include <limits>
#include <memory>
#include <sstream>
#include <string_view>
#include <system_error>
#include <tuple>

namespace agnocast::ctl {
namespace {

using wire::Opcode;

// A daemon under load answers within milliseconds.
constexpr int answer_patience_ms = 5'000;

Status status_of(Errc code) noexcept {
  if (code == Errc::permission_denied || code == Errc::access_denied ||
      code == Errc::daemon_untrusted)
    return Status::permission_denied;
  if (code == Errc::daemon_not_running) return Status::not_reachable;
  if (code == Errc::endpoint_gone) return Status::no_such_thing;
  if (code == Errc::invalid_argument) return Status::wrong_usage;  // the path of the socket
  return Status::failed;
}

tl::unexpected<Problem> unreachable(const std::string& path, const char* why) {
  return problem(Status::not_reachable, path, why, remedy_of(Errc::daemon_not_running));
}

/// Splits the name of a node for its endpoint or callback group.
template <class Part>
void split_node(const std::string& full, Part& part) {
  const std::size_t slash = full.rfind('/');
  part.node_name = slash == std::string::npos ? full : full.substr(slash + 1);
  part.node_namespace = slash == std::string::npos || slash == 0 ? "/" : full.substr(0, slash);
}

/// Returns the process that the body names; nullptr if the dump has none.
template <class Body>
Process* owner_of(System& system, const Body& body) {
  const auto found = system.processes.find(body.client);
  return found == system.processes.end() || found->second.facts.generation != body.client_generation
             ? nullptr
             : &found->second;
}

bool is_valid(const wire::DumpCallbackThread& thread) noexcept {
  // errno values are below 4096 in every kernel interface.
  constexpr std::uint32_t errno_max = 4095;
  const wire::ThreadScheduling& scheduling = thread.scheduling;
  return thread.thread != 0 && thread.thread <= std::numeric_limits<pid_t>::max() &&
         thread.setting <= wire::ThreadSetting::not_found &&
         thread.call <= wire::ThreadCall::sched_setaffinity && thread.os_errno <= errno_max &&
         thread.executor_count <= abi::callback_spin_count_max && scheduling.sets_policy <= 1 &&
         scheduling.sets_nice <= 1 && scheduling.sets_cpus <= 1;
}

bool is_of_threads(Opcode opcode) noexcept {
  return opcode == Opcode::dump_callback_group || opcode == Opcode::dump_callback_thread ||
         opcode == Opcode::dump_thread_executors;
}

/// Returns how many executors of the last thread are still to come.
std::size_t missing_executors(const System& system) noexcept {
  if (system.callback_threads.empty()) return 0;
  const ThreadFacts& last = system.callback_threads.back();
  return last.facts.executor_count - last.executors.size();
}

/// Returns whether everything that `end` counts has come.
bool is_complete(const System& system, const wire::DumpEnd& end, const wire::DumpEnd& seen) {
  return missing_executors(system) == 0 && end.process_count == seen.process_count &&
         end.topic_count == seen.topic_count && end.endpoint_count == seen.endpoint_count &&
         end.user_count == seen.user_count && end.refusal_count == seen.refusal_count &&
         end.callback_group_count == seen.callback_group_count &&
         end.callback_thread_count == seen.callback_thread_count &&
         end.thread_executors_count == seen.thread_executors_count;
}

/// Returns false if a thread is there twice, or spins an executor twice.
bool sort_threads(System& system) {
  std::sort(system.callback_groups.begin(), system.callback_groups.end(),
            [](const CallbackGroup& a, const CallbackGroup& b) {
              return std::tie(a.facts.client, a.facts.executor, a.facts.group) <
                     std::tie(b.facts.client, b.facts.executor, b.facts.group);
            });
  const auto key_of = [](const ThreadFacts& it) {
    return std::tie(it.facts.client, it.facts.thread);
  };
  auto& threads = system.callback_threads;
  std::sort(threads.begin(), threads.end(),
            [&](const ThreadFacts& a, const ThreadFacts& b) { return key_of(a) < key_of(b); });
  const auto has_twice = [](ThreadFacts& thread) {
    auto& executors = thread.executors;
    std::sort(executors.begin(), executors.end());
    return std::adjacent_find(executors.begin(), executors.end()) != executors.end();
  };
  return std::adjacent_find(threads.begin(), threads.end(),
                            [&](const ThreadFacts& a, const ThreadFacts& b) {
                              return key_of(a) == key_of(b);
                            }) == threads.end() &&
         std::none_of(threads.begin(), threads.end(), has_twice);
}

}  // namespace

std::uint64_t Topic::extent_bytes(const Endpoint& endpoint) const noexcept {
  return endpoint.is_publisher() ? abi::publisher_extent_bytes
                                 : abi::subscription_extent_bytes(facts.link_blocks);
}

bool is_stopped(const wire::DumpProcess& process) {
  if (process.pid == 0) return false;
  const UniqueFd file(
      ::open(("/proc/" + std::to_string(process.pid) + "/stat").c_str(), O_RDONLY | O_CLOEXEC));
  char line[512];
  const ssize_t bytes = file ? ::read(file.get(), line, sizeof line) : 0;
  if (bytes <= 0) return false;
  // "pid (name) state …"; the name may hold anything
  const std::string_view text(line, static_cast<std::size_t>(bytes));
  const std::size_t end = text.rfind(')');
  return end != std::string::npos && end + 2 < text.size() &&
         (text[end + 2] == 'T' || text[end + 2] == 't');
}

bool is_visible(const wire::DumpProcess& process) {
  const std::string status = contents_of(of_process(static_cast<pid_t>(process.pid), "status"));
  // Real, effective, saved: the daemon received one of them when the process connected.
  std::istringstream uids{std::string(line_after(status, "Uid:"))};
  for (std::uint64_t uid = 0; process.pid != 0 && uids >> uid;) {
    if (uid == process.uid) return true;
  }
  return false;
}

bool Process::owns(const Endpoint& endpoint) const noexcept {
  return endpoint.facts.client == facts.client &&
         endpoint.facts.client_generation == facts.generation;
}

const Process* System::process_of(const Endpoint& endpoint) const {
  const auto found = processes.find(endpoint.facts.client);
  return found == processes.end() || !found->second.owns(endpoint) ? nullptr : &found->second;
}

std::string words_of(const Process& process) {
  return escaped(process.name) + " (pid " + std::to_string(process.facts.pid) + ", uid " +
         std::to_string(process.facts.uid) + ")";
}

std::string process_words_of(const System& system, const Endpoint& endpoint) {
  const Process* const process = system.process_of(endpoint);
  return process == nullptr ? "" : words_of(*process);
}

bool System::is_silent(const Endpoint& subscription) const {
  const Process* const process = process_of(subscription);
  return process != nullptr && !subscription.is_publisher() &&
         subscription.facts.wait_set < abi::wait_set_count_max &&
         (process->facts.silent_wait_sets >> subscription.facts.wait_set & 1) != 0;
}

std::byte* System::region_of(const Endpoint& endpoint) const {
  const Process* const process = process_of(endpoint);
  if (process == nullptr || !process->region) return nullptr;
  // The mapping reaches to the end of the highest extent that fits into the region.
  if (endpoint.facts.extent % abi::page_bytes != 0 ||
      endpoint.facts.extent > process->region.bytes() ||
      process->region.bytes() - endpoint.facts.extent <
          topics.at(endpoint.facts.topic).extent_bytes(endpoint))
    return nullptr;
  return process->region.base();
}

std::uint64_t System::hold_quota(const Endpoint& subscription, const Endpoint& publisher) const {
  const Process* const reader = process_of(subscription);
  const Process* const writer = process_of(publisher);
  const bool is_of_others =
      reader != nullptr && writer != nullptr && reader->facts.uid != writer->facts.uid;
  return is_of_others ? subscription.facts.quota_of_others : subscription.facts.quota;
}

bool System::is_still_there(const Topic& topic, const Endpoint& endpoint) const {
  const auto words = words_of(topic);
  const std::uint64_t word =
      endpoint.is_publisher()
          ? words.publisher(endpoint.facts.index, offsetof(abi::PublisherEntry, word))
                .load(std::memory_order_acquire)
          : words.subscription(endpoint.facts.index, offsetof(abi::SubscriptionEntry, word))
                .load(std::memory_order_acquire);
  return abi::generation_of(word) == endpoint.facts.generation;
}

Observer::Observer(PacketSocket socket, std::string path)
    : socket_(std::move(socket)), path_(std::move(path)), received_(new AnswerPacket) {}

tl::unexpected<Problem> Observer::nonsense() const {
  return problem(Status::failed, path_, sentence_of(Errc::protocol_violation),
                 remedy_of(Errc::protocol_violation));
}

tl::unexpected<Problem> Observer::without_descriptors() const {
  const Failure why = failure_of_descriptors("this process may not open enough of them");
  if (why.code == Errc::os_failure)
    return tl::unexpected(
        Problem{Status::failed, "descriptors", why.what, "ulimit -n 4096", why.code});
  return tl::unexpected(
      Problem{Status::failed, path_, sentence_of(why.code), remedy_of(why.code), why.code});
}

Outcome<Observer> Observer::connect(const std::string& path) {
  auto socket = connect_to_daemon(path);
  if (!socket) {
    const Failure& failure = socket.error();
    if (failure.os_errno == EPROTOTYPE)
      return unreachable(escaped(path), "this is the socket of another program");
    std::string why = sentence_of(failure.code);
    if (failure.code == Errc::invalid_argument || failure.code == Errc::os_failure)
      why = failure.what;
    if (failure.code == Errc::daemon_untrusted)
      why += std::string(": ") + escaped(detail_of(failure));
    if (failure.os_errno != 0) why += ": " + std::generic_category().message(failure.os_errno);
    return tl::unexpected(Problem{status_of(failure.code), escaped(path), why,
                                  remedy_of(failure.code), failure.code});
  }
  Observer observer(std::move(*socket), escaped(path));
  wire::Observe hello{};
  hello.fingerprint = abi::fingerprint();
  if (auto sent = observer.send(Opcode::observe, hello); !sent) return tl::unexpected(sent.error());
  auto answer = observer.receive();
  if (!answer) return tl::unexpected(answer.error());
  AnswerPacket& welcome = **answer;
  wire::Observed observed{};
  if (welcome.header().opcode != Opcode::observed || !welcome.read(observed))
    return observer.nonsense();
  const UniqueFd board_fd = welcome.take_descriptor();
  if (!board_fd) return observer.without_descriptors();
  auto board = Mapping::map(board_fd.get(), abi::board_bytes, Mapping::Access::read);
  if (!board)
    return problem(Status::failed, "the board", board.error().what, remedy_of(board.error().code));
  observer.board_ = std::move(*board);
  observer.region_bytes_ = observed.client_region_bytes;
  return observer;
}

template <class Body>
Outcome<void> Observer::send(Opcode opcode, Body body) {
  body.header = {opcode, sizeof body, 1};
  const auto sent = socket_.send(std::as_bytes(std::span(&body, 1)), {}, Wait::yes);
  // A connection that was refused at once reads the reason.
  if (sent && *sent == Sent::would_block) return unreachable(path_, "agnocastd does not read");
  return {};
}

Outcome<AnswerPacket*> Observer::receive() {
  if (!received_->advance()) {
    if (auto came = receive_packet(); !came) return tl::unexpected(came.error());
  }
  if (!received_->is_whole()) {
    received_->begin({});
    return nonsense();
  }
  wire::Refused refused{};
  if (received_->header().opcode == Opcode::refused) {
    if (!received_->read(refused)) return nonsense();
    const auto code = static_cast<Errc>(refused.code);
    return tl::unexpected(
        Problem{status_of(code), path_, escaped(text_of(refused.text)), remedy_of(code), code});
  }
  return received_.get();
}

Outcome<void> Observer::receive_packet() {
  auto packet = socket_.receive(received_->buffer());
  // Usually the next one of many packets is there already.
  if (packet && packet->kind == Packet::Kind::nothing) {
    pollfd readable{socket_.fd(), POLLIN, 0};
    int ready = 0;
    do {
      ready = ::poll(&readable, 1, answer_patience_ms);
    } while (ready < 0 && errno == EINTR);
    if (ready <= 0) return unreachable(path_, "agnocastd does not answer within 5 s");
    packet = socket_.receive(received_->buffer());
  }
  if (!packet) return unreachable(path_, packet.error().what);
  if (packet->kind != Packet::Kind::data)
    return unreachable(path_, "agnocastd has closed the connection");
  if (packet->truncated) return nonsense();
  if (packet->descriptors_lost) return without_descriptors();
  received_->begin(std::move(*packet));
  return {};
}

Outcome<void> Observer::revoke(const wire::DumpProcess& process) {
  wire::Revoke request{};
  request.client = process.client;
  request.generation = process.generation;
  if (auto sent = send(Opcode::revoke, request); !sent) return sent;
  const auto answer = receive();
  if (!answer) return tl::unexpected(answer.error());
  if ((*answer)->header().opcode != Opcode::done) return nonsense();
  return {};
}

Outcome<std::uint64_t> Observer::log_level(std::uint64_t level) {
  wire::SetLogLevel request{};
  request.level = level;
  if (auto sent = send(Opcode::set_log_level, request); !sent) return tl::unexpected(sent.error());
  auto answer = receive();
  if (!answer) return tl::unexpected(answer.error());
  wire::LogLevelIs is{};
  if ((*answer)->header().opcode != Opcode::log_level_is || !(*answer)->read(is)) return nonsense();
  return is.level;
}

Outcome<Observer::Access> Observer::access(std::uint64_t domain, const std::string& topic) {
  wire::AskAccess request{};
  request.domain = domain;
  topic.copy(request.topic.text, sizeof request.topic.text - 1);
  if (auto sent = send(Opcode::ask_access, request); !sent) return tl::unexpected(sent.error());
  Access access;
  for (auto [kind, is] : {std::pair(wire::Kind::publisher, &access.publish),
                          std::pair(wire::Kind::subscription, &access.subscribe)}) {
    auto answer = receive();
    if (!answer) return tl::unexpected(answer.error());
    if ((*answer)->header().opcode != Opcode::access_is || !(*answer)->read(*is) ||
        is->kind != kind)
      return nonsense();
    is->principals[sizeof is->principals - 1] = '\0';
  }
  return access;
}

Outcome<System> Observer::look(LookOptions options) {
  wire::Dump request{};
  request.with_threads = options.threads ? 1 : 0;
  if (auto sent = send(Opcode::dump, request); !sent) return tl::unexpected(sent.error());
  System system;
  system.board = board_.base();
  wire::DumpEnd seen{};
  for (;;) {
    auto body = receive();
    if (!body) return tl::unexpected(body.error());
    if ((*body)->header().opcode == Opcode::dump_end) {
      wire::DumpEnd end{};
      if (!(*body)->read(end) || !is_complete(system, end, seen)) return nonsense();
      break;
    }
    auto accepted = options.threads && is_of_threads((*body)->header().opcode)
                        ? accept_threads(**body, system, seen)
                        : accept(**body, system, seen);
    if (!accepted) return tl::unexpected(accepted.error());
  }
  if (!sort_threads(system)) return nonsense();
  map_regions(system);
  return system;
}

Outcome<Journal> Observer::read_journal(std::uint64_t last, std::uint64_t count) {
  wire::ReadJournal request{};
  request.last = last;
  request.count = count;
  if (auto sent = send(Opcode::read_journal, request); !sent) return tl::unexpected(sent.error());
  Journal journal;
  for (;;) {
    auto body = receive();
    if (!body) return tl::unexpected(body.error());
    if ((*body)->header().opcode == Opcode::journal_end) {
      if (!(*body)->read(journal.end) || journal.end.record_count != journal.records.size())
        return nonsense();
      return journal;
    }
    journal.records.emplace_back();
    if ((*body)->header().opcode != Opcode::journal_record ||
        !(*body)->read(journal.records.back()))
      return nonsense();
  }
}

Outcome<void> Observer::accept(AnswerPacket& body, System& system, wire::DumpEnd& seen) const {
  switch (body.header().opcode) {
    case Opcode::dump_daemon:
      if (!body.read(system.daemon)) return nonsense();
      return {};
    case Opcode::dump_process: {
      Process process;
      if (!body.read(process.facts) || process.facts.client >= abi::client_count_max ||
          process.facts.window_count > abi::window_count_max || process.facts.region_count > 1)
        return nonsense();
      process.name = text_of(process.facts.name);
      process.blocked_by = text_of(process.facts.blocked_by);
      if (process.facts.region_count == 1) {
        process.region_fd = body.take_descriptor();
        if (!process.region_fd) return nonsense();
      }
      system.processes.insert_or_assign(process.facts.client, std::move(process));
      ++seen.process_count;
      return {};
    }
    case Opcode::dump_topic: {
      Topic topic;
      if (!body.read(topic.facts) || topic.facts.topic >= abi::topic_count_max ||
          topic.facts.link_blocks == 0 || topic.facts.link_blocks > abi::link_block_max)
        return nonsense();
      topic.name = text_of(topic.facts.name);
      topic.type = text_of(topic.facts.type);
      system.topics.insert_or_assign(topic.facts.topic, std::move(topic));
      ++seen.topic_count;
      return {};
    }
    case Opcode::dump_endpoint: {
      Endpoint endpoint;
      if (!body.read(endpoint.facts)) return nonsense();
      const auto topic = system.topics.find(endpoint.facts.topic);
      const bool publisher = endpoint.is_publisher();
      if (topic == system.topics.end() ||
          (!publisher && endpoint.facts.kind != wire::Kind::subscription) ||
          endpoint.facts.index >= (publisher
                                       ? topic->second.facts.link_blocks * abi::link_block_count
                                       : abi::subscription_count_max) ||
          endpoint.facts.slot_count > abi::slot_count_max)
        return nonsense();
      split_node(text_of(endpoint.facts.node), endpoint);
      if (const auto owner = system.processes.find(endpoint.facts.client);
          owner != system.processes.end()) {
        Process& process = owner->second;
        ++(publisher ? process.publisher_count : process.subscription_count);
        if (process.topics.empty() || process.topics.back() != endpoint.facts.topic)
          process.topics.push_back(endpoint.facts.topic);  // endpoints come topic by topic
      }
      (publisher ? topic->second.publishers : topic->second.subscriptions)
          .push_back(std::move(endpoint));
      ++seen.endpoint_count;
      return {};
    }
    case Opcode::dump_user:
      system.users.emplace_back();
      if (!body.read(system.users.back())) return nonsense();
      ++seen.user_count;
      return {};
    case Opcode::dump_refusal:
      system.refusals.emplace_back();
      if (!body.read(system.refusals.back())) return nonsense();
      ++seen.refusal_count;
      return {};
    default:
      return nonsense();
  }
}

Outcome<void> Observer::accept_threads(AnswerPacket& body, System& system,
                                       wire::DumpEnd& seen) const {
  switch (body.header().opcode) {
    case Opcode::dump_callback_group:
      ++seen.callback_group_count;
      return accept_group(body, system);
    case Opcode::dump_callback_thread:
      ++seen.callback_thread_count;
      return accept_thread(body, system);
    default:
      ++seen.thread_executors_count;
      return accept_executors(body, system);
  }
}

Outcome<void> Observer::accept_group(AnswerPacket& body, System& system) const {
  CallbackGroup group;
  if (!body.read(group.facts) || group.facts.reentrant > 1) return nonsense();
  Process* const owner = owner_of(system, group.facts);
  if (owner == nullptr || ++owner->callback_group_count > abi::callback_group_count_max)
    return nonsense();
  split_node(text_of(group.facts.node), group);
  group.name = text_of(group.facts.name);
  system.callback_groups.push_back(std::move(group));
  return {};
}

Outcome<void> Observer::accept_thread(AnswerPacket& body, System& system) const {
  ThreadFacts thread;
  if (missing_executors(system) != 0 || !body.read(thread.facts) || !is_valid(thread.facts))
    return nonsense();
  Process* const owner = owner_of(system, thread.facts);
  if (owner == nullptr || ++owner->callback_thread_count > abi::callback_thread_count_max)
    return nonsense();
  owner->callback_spin_count += thread.facts.executor_count;
  if (owner->callback_spin_count > abi::callback_spin_count_max) return nonsense();
  system.callback_threads.push_back(std::move(thread));
  return {};
}

Outcome<void> Observer::accept_executors(AnswerPacket& body, System& system) const {
  wire::DumpThreadExecutors some{};
  const std::size_t missing = missing_executors(system);
  if (missing == 0 || !body.read(some)) return nonsense();
  const std::size_t count = std::min(missing, std::size(some.executor));
  auto& executors = system.callback_threads.back().executors;
  executors.insert(executors.end(), some.executor, some.executor + count);
  return {};
}

// Maps each region only as far as its extents reach: a region is a gigabyte of addresses.
void Observer::map_regions(System& system) const {
  std::map<std::uint64_t, std::uint64_t> end;
  for (const auto& [index, topic] : system.topics) {
    for (const auto* endpoints : {&topic.publishers, &topic.subscriptions}) {
      for (const Endpoint& endpoint : *endpoints) {
        const std::uint64_t bytes = topic.extent_bytes(endpoint);
        if (endpoint.facts.extent > region_bytes_ || region_bytes_ - endpoint.facts.extent < bytes)
          continue;
        std::uint64_t& reached = end[endpoint.facts.client];
        reached = std::max(reached, endpoint.facts.extent + bytes);
      }
    }
  }
  for (auto& [index, process] : system.processes) {
    if (!process.region_fd) continue;
    const std::uint64_t bytes = std::max(end[index], abi::page_bytes);
    struct stat file {};
    if (::fstat(process.region_fd.get(), &file) != 0 ||
        static_cast<std::uint64_t>(file.st_size) < bytes) {
      process.region_fault = "its region is shorter than its extents";
    } else if (auto mapping = Mapping::map(process.region_fd.get(), bytes, Mapping::Access::read)) {
      process.region = std::move(*mapping);
    } else {
      process.region_fault = "its region cannot be mapped";
    }
    process.region_fd.reset();
  }
}

Outcome<Look> look_at(const std::string& socket, LookOptions options) {
  auto observer = Observer::connect(socket);
  if (!observer) return tl::unexpected(observer.error());
  auto system = observer->look(options);
  if (!system) return tl::unexpected(system.error());
  return Look{std::move(*observer), std::move(*system)};
}

}  // namespace agnocast::ctl
