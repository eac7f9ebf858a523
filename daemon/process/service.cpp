// SPDX-License-Identifier: Apache-2.0

#include <daemon/process/service.hpp>

#include <daemon/config/options.hpp>
#include <daemon/process/refuser.hpp>
#include <daemon/process/watchdog.hpp>
#include <daemon/requests/broker.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <journal/cases.hpp>

#include <fcntl.h>
#include <grp.h>
#include <sys/epoll.h>
#include <sys/random.h>
#include <sys/signalfd.h>
#include <sys/stat.h>
#include <sys/sysinfo.h>
#include <unistd.h>

#include <bit>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <ctime>
#include <memory>
#include <utility>
#include <vector>

namespace agnocast::daemon {
namespace {

Trouble trouble_of(const Failure& failure) {
  const char* const detail = detail_of(failure);
  std::string what = *detail != '\0' ? detail : failure.what;
  if (failure.os_errno != 0) what += std::string(": ") + std::strerror(failure.os_errno);
  return {what, remedy_of(failure.code)};
}
Trouble trouble_of(const Complaint& complaint) {
  return {complaint.what, remedy_of(complaint.code)};
}

// The stack lies at the top of the user's addresses, so an address in it shows the number of bits.
unsigned address_bits() noexcept {
  const int here = 0;
  return static_cast<unsigned>(std::bit_width(reinterpret_cast<std::uintptr_t>(&here)));
}

std::uint64_t memory_bytes() noexcept {
  struct sysinfo info {};
  return ::sysinfo(&info) == 0 ? std::uint64_t{info.totalram} * info.mem_unit : 0;
}

// Two incarnations must not have the same number, or a client would take a new board for its own.
std::uint64_t random_incarnation() noexcept {
  std::uint64_t value = 0;
  if (::getrandom(&value, sizeof value, 0) != sizeof value || value == 0) {
    timespec now{};
    ::clock_gettime(CLOCK_MONOTONIC, &now);
    value = static_cast<std::uint64_t>(now.tv_sec) << 32 ^ static_cast<std::uint64_t>(now.tv_nsec) ^
            static_cast<std::uint64_t>(::getpid()) << 48;
  }
  return value;
}

std::optional<gid_t> group_of(const std::string& name) {
  // getgrnam also reads files and may ask the network; called once, at the start.
  const group* const found = ::getgrnam(name.empty() ? "agnocast" : name.c_str());
  if (found == nullptr) return std::nullopt;
  return found->gr_gid;
}

// Makes SIGTERM and SIGINT events, so that the end comes between two other events.
Result<UniqueFd> watch_signals() noexcept {
  sigset_t wanted;
  ::sigemptyset(&wanted);
  ::sigaddset(&wanted, SIGTERM);
  ::sigaddset(&wanted, SIGINT);
  if (::sigprocmask(SIG_BLOCK, &wanted, nullptr) != 0)
    return fail(Errc::os_failure, "blocking signals", errno);
  UniqueFd fd(::signalfd(-1, &wanted, SFD_CLOEXEC | SFD_NONBLOCK));
  if (!fd) return fail(Errc::os_failure, "watching signals", errno);
  return fd;
}

/// The parts of one run, in the order of their construction.
class Service {
 public:
  Service(const Config& config, DescriptorStore store, Log& log)
      : config_(config), store_(std::move(store)), log_(log) {}

  std::optional<Trouble> run(const std::string& socket);

 private:
  std::optional<Trouble> prepare(const std::string& socket);
  std::optional<Trouble> begin();
  std::optional<Trouble> go_on();
  std::optional<Trouble> refuse(UniqueFd socket, const Failure& why);
  std::optional<Trouble> wait();
  void look_at_passed() const;
  void say_ready(bool resumed);

  const Config& config_;
  DescriptorStore store_;
  Log& log_;
  ListenerOptions place_;
  UniqueFd passed_;  // the manager's socket, until it is used
  Arena arena_;
  UniqueFd signals_;
  std::optional<Dispatcher> dispatcher_;
  std::unique_ptr<Errands> errands_, closings_;
  std::optional<Disposal> disposal_;
  std::optional<Listener> listener_;
  std::optional<Broker> broker_;
  std::optional<Refuser> refuser_;
  int ended_by_ = 0;
};

std::optional<Trouble> Service::prepare(const std::string& socket) {
  const auto arena =
      plan_arena({config_.heap.arena_base, config_.heap.arena_bytes, config_.heap.window_bytes},
                 address_bits(), memory_bytes());
  if (!arena)
    return Trouble{
        "the arena does not fit into the addresses of this machine",
        "correct arena_base, arena_bytes and window_bytes in [heap] (whole MiB, in steps of 2), or "
        "leave them out"};
  arena_ = *arena;
  const auto group = group_of(config_.daemon.socket_group);
  if (!group && !config_.daemon.socket_group.empty())
    return Trouble{"there is no group " + config_.daemon.socket_group,
                   "groupadd " + config_.daemon.socket_group};
  // Only root can give the socket to the usual group; a configured group is mandatory.
  const bool wants_group = !config_.daemon.socket_group.empty() || ::geteuid() == 0;
  std::string listens_at = socket;
  std::vector<UniqueFd> passed = store_.take_passed_sockets();
  if (passed.size() > 1)
    return Trouble{"the service manager passes " + std::to_string(passed.size()) + " sockets",
                   "use only one ListenSequentialPacket= in agnocastd.socket"};
  if (!passed.empty()) {
    auto place = Listener::place_of(passed.front());
    if (!place) return trouble_of(place.error());
    listens_at = std::move(*place);
    passed_ = std::move(passed.front());
    // systemd passes it in the mode of NonBlocking=, which is off.
    ::fcntl(passed_.get(), F_SETFL, ::fcntl(passed_.get(), F_GETFL) | O_NONBLOCK);
  }
  place_ = {socket, choose_runtime_directory(config_, listens_at),
            static_cast<mode_t>(config_.daemon.socket_mode), wants_group ? group : std::nullopt};

  auto signals = watch_signals();
  if (!signals) return trouble_of(signals.error());
  signals_ = std::move(*signals);
  auto dispatcher = Dispatcher::create();
  if (!dispatcher) return trouble_of(dispatcher.error());
  dispatcher_.emplace(std::move(*dispatcher));
  auto errands = Errands::create(*dispatcher_);
  if (!errands) return trouble_of(errands.error());
  errands_ = std::move(*errands);
  auto closings = Errands::create(*dispatcher_);
  if (!closings) return trouble_of(closings.error());
  closings_ = std::move(*closings);
  disposal_.emplace(*closings_);
  const auto token = dispatcher_->add(signals_.get(), EPOLLIN, [this](std::uint32_t) {
    signalfd_siginfo info{};
    if (::read(signals_.get(), &info, sizeof info) == sizeof info)
      ended_by_ = static_cast<int>(info.ssi_signo);
  });
  if (!token) return trouble_of(token.error());
  return std::nullopt;
}

std::optional<Trouble> Service::begin() {
  // Left by a start that did not complete; it served no client.
  store_.remove_left_over();
  auto listener = Listener::open(place_, std::move(passed_));
  if (!listener) return trouble_of(listener.error());
  listener_.emplace(std::move(*listener));
  look_at_passed();
  auto regions = Regions::create(store_);
  if (!regions) return trouble_of(regions.error());
  broker_.emplace(BrokerOptions{arena_, config_, listener_->former_count()}, log_, *dispatcher_,
                  *listener_, std::move(*regions), store_, *errands_, *disposal_);
  if (auto formatted = broker_->format(random_incarnation()); !formatted)
    return trouble_of(formatted.error());
  listener_->remove_names(!store_.keeps());
  if (auto started = broker_->start(); !started) return trouble_of(started.error());
  say_ready(false);
  return wait();
}

std::optional<Trouble> Service::go_on() {
  UniqueFd socket = store_.take("listen");
  UniqueFd lock = store_.take("lock");
  UniqueFd board = store_.take("board");
  UniqueFd journal = store_.take("journal");
  namespace stored = journal::stored;
  if (journal::decide_stored(stored::tables, board && journal, stored::none) ==
      journal::StoredDecision::start_anew) {
    log_.write(LogLevel::error, "previous incarnation lost",
               {{"why", "the store has lost a descriptor"}});
    for (const char* const name : {"listen", "lock", "board", "journal"}) store_.remove(name);
    socket.reset();
    lock.reset();
    return begin();
  }
  const auto place_to_refuse = [&] { return std::move(passed_ ? passed_ : socket); };
  auto regions = Regions::adopt(store_, std::move(board), std::move(journal));
  if (!regions) return refuse(place_to_refuse(), regions.error());
  {
    // Before any other part is made: the tables have the place of the listener.
    const Registry registry(regions->memory());
    if (auto checked = registry.check(); !checked)
      return refuse(place_to_refuse(), checked.error());
    auto listener = Listener::adopt(place_, std::move(passed_), std::move(socket), std::move(lock),
                                    registry.header().doorbells);
    if (!listener) return trouble_of(listener.error());
    listener_.emplace(std::move(*listener));
  }
  if (listener_->renewed())
    log_.write(LogLevel::error, "socket made anew", {{"socket", listener_->path()}});
  if (auto kept = listener_->keep(store_); !kept) return trouble_of(kept.error());
  look_at_passed();
  if (!listener_->is_passed() && listener_->path() != place_.path)
    log_.write(LogLevel::warning, "socket stays where it is", {{"socket", listener_->path()}});
  broker_.emplace(BrokerOptions{arena_, config_, listener_->former_count()}, log_, *dispatcher_,
                  *listener_, std::move(*regions), store_, *errands_, *disposal_);
  if (auto resumed = broker_->resume(); !resumed) {
    if (resumed.error().code != Errc::store_damaged) return trouble_of(resumed.error());
    UniqueFd again(::fcntl(listener_->socket().fd(), F_DUPFD_CLOEXEC, 0));
    broker_.reset();
    return refuse(std::move(again), resumed.error());
  }
  if (auto started = broker_->start(); !started) return trouble_of(started.error());
  say_ready(true);
  return wait();
}

std::optional<Trouble> Service::refuse(UniqueFd socket, const Failure& why) {
  // Another try may succeed.
  if (why.code == Errc::os_failure || !socket) return trouble_of(why);
  const std::string text = trouble_of(why).what;
  refuser_.emplace(PacketListener(std::move(socket)), *dispatcher_, *disposal_, log_, why.code,
                   text);
  if (auto started = refuser_->start(); !started) return trouble_of(started.error());
  log_.write(LogLevel::error, "refusing everybody",
             {{"why", text},
              {"hint", why.code == Errc::layout_mismatch
                           ? "start the previous agnocastd again, or stop this one and "
                             "restart every process"
                           : remedy_of(why.code)}});
  // Ready all the same: a manager that restarted it again and again would change nothing.
  notify("READY=1\nSTATUS=refusing everybody: " + text);
  return wait();
}

// The socket's unit decides; the log warns a user whose configuration differs.
void Service::look_at_passed() const {
  const std::string differences = listener_->differences(place_);
  if (!differences.empty())
    log_.write(LogLevel::warning, "socket is not as configured",
               {{"socket", listener_->path()},
                {"why", differences},
                {"hint",
                 "agnocastd.socket decides: systemctl edit agnocastd.socket, then systemctl "
                 "restart agnocastd.socket"}});
}

void Service::say_ready(bool resumed) {
  if (const auto forbidden = Regions::can_forbid_holes(); !forbidden)
    log_.write(
        LogLevel::warning, "holes are allowed",
        {{"why", trouble_of(forbidden.error()).what},
         {"then",
          "a process that punches holes into its region can block this daemon, and the processes "
          "that exchange messages with it"},
         {"hint",
          "it needs Linux 6.0 and CAP_LINUX_IMMUTABLE, which root in a container often lacks"}});
  const Arena& arena = broker_->arena();
  log_.write(LogLevel::notice, "ready",
             {{"pid", ::getpid()},
              {"socket", listener_->path()},
              {"arena_bytes", arena.bytes},
              {"window_bytes", arena.window_bytes},
              {"unprivileged", ::geteuid() == 0 ? "no" : "yes"}});
  // One datagram: a reader that waits for the first line then reads the second.
  notify(std::string("READY=1\nSTATUS=serving") + (resumed ? "; continues the previous run" : ""));
}

std::optional<Trouble> Service::wait() {
  Watchdog watchdog;
  MemoryReserve::install();
  while (ended_by_ == 0) {
    static_cast<void>(MemoryReserve::refill());
    const int due_ms = broker_ ? broker_->due_ms() : refuser_ ? refuser_->due_ms() : -1;
    if (auto waited = dispatcher_->wait(watchdog.sooner(due_ms)); !waited)
      return trouble_of(waited.error());
    watchdog.tick();
    if (refuser_) refuser_->tick();
    if (!broker_) continue;
    broker_->serve_waiting();
    broker_->tick();
  }
  notify("STOPPING=1");
  const bool is_last = !store_.keeps() || ended_by_ == SIGINT;
  if (listener_ && !refuser_) listener_->remove_names(is_last);
  log_.write(LogLevel::notice, "ended", {{"kept", is_last ? "no" : "yes"}});
  log_.flush(true);
  return std::nullopt;
}

std::optional<Trouble> Service::run(const std::string& socket) {
  if (auto trouble = prepare(socket)) return trouble;
  if (store_.is_refused())
    log_.write(
        LogLevel::warning, "nothing is kept",
        {{"why", "the service manager keeps no descriptors"},
         {"then",
          "the end of this daemon is the end of its incarnation: the next daemon begins with "
          "nothing, and every process has to join it again"},
         {"hint", "set FileDescriptorStoreMax= in the unit, or use --fd-store=own"}});
  // The lock enters the store after board and journal, and stays there.
  return store_.has("listen") || store_.has("lock") ? go_on() : begin();
}

}  // namespace

std::optional<Trouble> serve(const Config& config, const std::string& socket, DescriptorStore store,
                             Log& log) {
  return Service(config, std::move(store), log).run(socket);
}

}  // namespace agnocast::daemon
