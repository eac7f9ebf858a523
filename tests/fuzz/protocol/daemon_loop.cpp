// SPDX-License-Identifier: Apache-2.0
//
// Daemon loop: see the header.

#include <tests/fuzz/protocol/daemon_loop.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/check.hpp>
#include <base/sockets/answer_packet.hpp>

#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <set>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

namespace agnocast::daemon::fuzz {

namespace {

Config small_config() {
  Config config;
  config.limits.clients = 8;  // small tables fill up soon
  config.limits.topics = 4;
  config.limits.publishers_per_topic = 6;
  config.limits.subscriptions_per_topic = 8;
  config.quota.dumps_per_second = unlimited;  // no input waits
  return config;
}

constexpr Arena arena{arena_base, window_count* window_bytes, window_bytes};

Log silent_log() {
  return {{"fuzz"},
          LogLevel::error,
          Log::Format::people,
          [](std::string_view) { return true; },
          [] { return std::uint64_t{0}; }};
}

/// A process never uses the id of a request again, except to repeat that.
bool is_reused(const Endpoint* before, const Process& from, const CreateRequest& request) {
  return before != nullptr ? !request.again || before->left
                           : from.created.contains(request.request);
}

}  // namespace

// Of a directory of directories: two, and one for each (proc(5)).
nlink_t ThreadsOfDaemon::count() {
  struct stat tasks {};
  AGNOCAST_CHECK(::stat("/proc/self/task", &tasks) == 0);
  return tasks.st_nlink;
}

ThreadsOfDaemon::~ThreadsOfDaemon() {
  while (count() > before_) std::this_thread::sleep_for(std::chrono::microseconds(100));
}

DaemonLoop::DaemonLoop()
    : log_(silent_log()),
      dispatcher_(std::move(Dispatcher::create().value())),
      errands_(std::move(Errands::create(dispatcher_).value())),
      closings_(std::move(Errands::create(dispatcher_).value())),
      disposal_(*closings_),
      listener_(std::move(
          Listener::open({directory_.path("socket"), directory_.path(), 0666, {}}, {}).value())),
      broker_({arena, small_config(), 0}, log_, dispatcher_, listener_,
              std::move(Regions::create(store_).value()), store_, *errands_, disposal_) {
  AGNOCAST_CHECK(::chmod(directory_.path().c_str(), 0755) == 0);  // for the other user
  AGNOCAST_CHECK(broker_.format(incarnation).has_value());
  AGNOCAST_CHECK(broker_.start().has_value());
}

// --- the daemon

bool DaemonLoop::has_errands() const {
  using Lane = Errands::Lane;
  std::set<std::uint32_t> uids{::geteuid()};
  for (const Process& process : processes_) uids.insert(process.uid);
  for (const std::uint32_t uid : uids) {
    if (closings_->waiting(Lane::receiving, uid) != 0) return true;
    for (const Lane lane : {Lane::looking, Lane::freeing, Lane::clearing, Lane::scheduling}) {
      if (errands_->waiting(lane, uid) != 0) return true;
    }
  }
  return false;
}

// A round may end with an answer of an errand that the next one finds.
void DaemonLoop::run_until_quiet() {
  Flags were_greeted{}, were_revoked{};
  for (std::size_t i = 0; i < processes_.size(); ++i) {
    were_greeted[i] = processes_[i].greeted;
    were_revoked[i] = processes_[i].revoked;
  }
  for (int quiet_rounds = 0; quiet_rounds < 2;) {
    const bool had_errands = has_errands();
    AGNOCAST_CHECK(dispatcher_.wait(had_errands ? 1 : 0).has_value());
    broker_.serve_waiting();
    broker_.tick();
    const bool is_quiet = !hear() && !had_errands && broker_.due_ms() != 0;
    quiet_rounds = is_quiet ? quiet_rounds + 1 : 0;
  }
  judge_revocations(were_greeted, were_revoked);
  for (Process& process : processes_) {
    if (std::exchange(process.hung_up, false)) AGNOCAST_CHECK(process.revoked || &process == asks_);
  }
}

// A process without a connection does not hear of it. Nobody has to ask where a process seems to
// hold more than it may: stores and lost connections bring that about. But the daemon looks for
// seconds first (daemon/death/hold_watch.hpp).
void DaemonLoop::judge_revocations(const Flags& were_greeted, const Flags& were_revoked) {
  constexpr std::chrono::milliseconds looks_at_least{3'900};  // four seconds, by rounded clocks
  for (std::size_t i = 0; i < processes_.size(); ++i) {
    Process& process = processes_[i];
    if (process.client && !process.revoked && registry().is_revoked(*process.client)) {
      AGNOCAST_CHECK(!were_greeted[i]);
      Oracle::revoked(process);
    }
    if (process.revoked && !were_revoked[i] && number(*process.client) != is_revoking_)
      AGNOCAST_CHECK(std::chrono::steady_clock::now() - begin_ >= looks_at_least);
  }
}

bool DaemonLoop::hear() {
  bool heard = hear_observer();
  for (Process& process : processes_) heard = hear(process) || heard;
  return heard;
}

bool DaemonLoop::hear(Process& process) {
  alignas(8) std::array<std::byte, wire::packet_bytes_max> buffer;
  bool heard = false;
  while (process.connection) {
    auto packet = process.connection.receive(buffer);
    if (packet && packet->kind == Packet::Kind::nothing) break;
    heard = true;
    if (!packet || packet->kind == Packet::Kind::end) {
      close(process);
      process.hung_up = true;
      break;
    }
    AGNOCAST_CHECK(!packet->truncated && !packet->descriptors_lost);
    ++process.packet_count;
    oracle_.hear(process, {std::span(buffer).first(packet->bytes), packet->fds()});
  }
  return heard;
}

bool DaemonLoop::hear_observer() {
  AnswerPacket answer;
  bool heard = false;
  while (observer_) {
    auto packet = observer_.receive(answer.buffer());
    if (packet && packet->kind == Packet::Kind::nothing) break;
    heard = true;
    if (!packet || packet->kind == Packet::Kind::end) {
      observer_.close();
      break;
    }
    AGNOCAST_CHECK(!packet->truncated && !packet->descriptors_lost);
    answer.begin(std::move(*packet));
    do {
      AGNOCAST_CHECK(answer.is_whole());
      oracle_.hear_observer(answer.header().opcode);
    } while (answer.advance());
  }
  return heard;
}

// --- a client's packets

bool DaemonLoop::connect(Process& process) {
  if (!process.running) {
    process.running =
        std::make_unique<PeerProcess>(static_cast<uid_t>(&process - processes_.data()) % 2);
    process.uid = process.running->uid();
  }
  process.connection = process.running->connect(listener_.path());
  run_until_quiet();
  return static_cast<bool>(process.connection);
}

void DaemonLoop::close(Process& process) {
  process.connection.close();
  process.packet_count = 0;
  process.greeted = false;
}

void DaemonLoop::disconnect(Process& process) {
  close(process);
  run_until_quiet();
}

void DaemonLoop::serve(Process& from, std::span<const std::byte> packet, std::size_t fd_count,
                       const BroughtWindow& brought) {
  if (packet.empty() || (!from.connection && !connect(from))) return;
  const Request request =
      decode(packet, {fd_count, false, false}, from.greeted ? Role::client : Role::unknown);
  if (const auto* const create = std::get_if<CreateRequest>(&request)) {
    if (is_reused(oracle_.created_before(from, *create), from, *create)) return;
  }
  // A process that has a place comes back with `rejoin`. With another `hello` it would have two.
  if (std::holds_alternative<wire::Hello>(request) && from.client && !from.revoked) return;
  if (std::holds_alternative<wire::Observe>(request)) return;  // it would be another observer
  oracle_.expect_answer(&from, request_id_of(request));
  const std::vector<int> fds(fd_count, fd_count == 0 ? -1 : brought.fd->get());
  const auto sent = from.connection.send(packet, fds);
  if (!sent || *sent != Sent::sent) return;  // it takes no descriptors now
  const bool was_revoked = from.revoked;
  asks_ = &from;
  run_until_quiet();
  asks_ = nullptr;
  // What it has asked for has ended with its session.
  if (from.revoked == was_revoked) {
    const auto* const rejected = std::get_if<Rejected>(&request);
    const bool may_hang_up =
        fd_count != 0 || (rejected != nullptr && rejected->ends_connection) || from.revoked;
    AGNOCAST_CHECK(from.connection || may_hang_up);
    if (!may_hang_up) oracle_.check_answered(request);
    conclude(from, request, brought);
  }
  oracle_.end_answer();
  // A process that may not come back tries again on another connection.
  if (from.client && !from.greeted && from.connection) disconnect(from);
}

void DaemonLoop::conclude(Process& from, const Request& request, const BroughtWindow& brought) {
  if (const auto* const hello = std::get_if<wire::Hello>(&request)) {
    oracle_.hello_served(from, *hello);
  } else if (const auto* const again = std::get_if<wire::Rejoin>(&request)) {
    oracle_.rejoin_served(from, *again);
  } else if (std::holds_alternative<wire::WindowRequest>(request)) {
    oracle_.window_served(from);
  } else if (const auto* const former = std::get_if<wire::BringWindow>(&request)) {
    oracle_.window_brought(from, *former, former->base == brought.base && from.uid == brought.uid);
  } else if (const auto* const blocked = std::get_if<wire::Blocked>(&request)) {
    oracle_.blocked(from, *blocked);
  } else if (const auto* const endpoint = std::get_if<CreateRequest>(&request)) {
    oracle_.create_served(from, *endpoint);
  } else if (const auto* const leave = std::get_if<LeaveRequest>(&request)) {
    oracle_.leave_served(from, *leave);
  } else if (const auto* const drained = std::get_if<DrainedRequest>(&request)) {
    oracle_.drained_served(from, *drained);
  } else if (const auto* const unlinked = std::get_if<wire::Unlinked>(&request)) {
    oracle_.unlinked(from, *unlinked);
  }
}

// --- the observer's packets

void DaemonLoop::connect_observer() {
  observer_ = std::move(PacketSocket::connect(listener_.path()).value());
  run_until_quiet();
}

void DaemonLoop::serve_observer(std::span<const std::byte> packet) {
  if (!observer_) connect_observer();
  const Request request = decode(packet, {}, Role::observer);
  oracle_.expect_answer(nullptr, 0);
  const auto sent = observer_.send(packet);
  AGNOCAST_CHECK(sent && *sent == Sent::sent);
  if (const auto* const revocation = std::get_if<wire::Revoke>(&request))
    is_revoking_ = revocation->client;
  run_until_quiet();
  is_revoking_.reset();
  AGNOCAST_CHECK(static_cast<bool>(observer_));
  oracle_.observer_served(request);
  oracle_.end_answer();
}

// --- the end of a process

void DaemonLoop::die(Process& process) {
  Process dead = std::exchange(process, Process{});
  dead.running.reset();
  dead.connection.close();
  run_until_quiet();
}

}  // namespace agnocast::daemon::fuzz
