// SPDX-License-Identifier: Apache-2.0

#include <daemon/process/supervisor.hpp>

#include <base/clock.hpp>
#include <base/sockets/unix_address.hpp>
#include <base/text/standard_error.hpp>
#include <daemon/process/child_process.hpp>
#include <daemon/process/hidden_socket.hpp>
#include <daemon/transport/descriptor_store.hpp>

#include <fcntl.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/signalfd.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <map>
#include <utility>
#include <vector>

namespace agnocast::daemon {
namespace {

// Names the supervisor's pid to its worker.
constexpr const char* supervisor_variable = "AGNOCASTD_SUPERVISOR";
constexpr int first_passed = 3;                   // where LISTEN_FDS begins
constexpr std::size_t datagram_bytes_max = 4096;  // the same limit as systemd's
constexpr std::size_t descriptors_per_datagram_max = 253;
constexpr std::uint64_t pause_first_ms = 20;
// A worker that was ready found nothing at its start that kills it: at most ten runs a second.
constexpr std::uint64_t life_of_ready_ms = 100;
constexpr std::uint64_t pause_most_ms = 5'000;
// A worker that lived so long did not die of what it found at its start.
constexpr std::uint64_t settled_ms = 10'000;

// How long a worker may take from the request to end until its loop reports it, and from then
// until it has ended. A worker that hangs delays the end by the first one: less than a second.
constexpr std::uint64_t stop_patience_ms = 800, end_patience_ms = 5'000;
// Time in which the worker was ready to run and had no processor counts neither there nor for the
// watchdog, up to this.
constexpr std::uint64_t wait_most_ms = 10'000;
// How long a worker may take until it serves; systemd's default.
constexpr std::uint64_t start_patience_ms = 90'000;
// Interval of looks at a worker that is to end, and how long the supervisor's end waits for it.
constexpr std::uint64_t look_interval_ms = 20, kill_patience_ms = 150;
// How long a worker that holds nothing any more may take until it has ended; usually no time.
constexpr std::uint64_t remains_patience_ms = 500;

// Returns the pause before the next worker. Clients wait for it, however often a ready daemon has
// died before: only a row of failed starts makes the pause long.
std::uint64_t pause_after(unsigned deaths_before, unsigned failed_starts,
                          std::uint64_t lived_ms) noexcept {
  if (deaths_before == 0) return 0;
  const auto doubled = [](unsigned times) { return pause_first_ms << std::min(times, 16U); };
  return failed_starts == 0 ? std::min(doubled(deaths_before - 1),
                                       life_of_ready_ms - std::min(lived_ms, life_of_ready_ms))
                            : std::min(doubled(failed_starts - 1), pause_most_ms);
}

// A fork has all descriptors twice for a moment, and the worker needs about two for each.
std::size_t kept_limit() noexcept {
  constexpr rlim_t of_ourselves = 64;
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return kept_count_max;
  const rlim_t pairs = (std::max(limit.rlim_cur, of_ourselves) - of_ourselves) / 2;
  return std::min<rlim_t>(pairs, kept_count_max);
}

std::string value_of(const char* name) {
  const char* const value = std::getenv(name);
  return value == nullptr ? "" : value;
}

}  // namespace

std::optional<Notification> parse_notification(std::string_view text) {
  Notification notification;
  notification.name = "stored";
  if (text.find('\0') != std::string_view::npos) return std::nullopt;
  while (!text.empty()) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(text.size(), line.size() + 1));
    if (line == "READY=1") notification.ready = true;
    if (line == "STOPPING=1") notification.stopping = true;
    if (line == "WATCHDOG=1") notification.watchdog = true;
    if (line == "FDSTORE=1") notification.store = true;
    if (line == "FDSTOREREMOVE=1") notification.remove = true;
    if (line.starts_with("STATUS=")) notification.status = line.substr(7);
    if (line.starts_with("FDNAME=")) notification.name = line.substr(7);
  }
  // LISTEN_FDNAMES separates names by colons; the rest is systemd's rule
  // (sd_pid_notify_with_fds(3)).
  const auto fits = [](char c) { return c > ' ' && c < 127 && c != ':'; };
  const std::string& name = notification.name;
  if (name.empty() || name.size() > 255 || !std::all_of(name.begin(), name.end(), fits))
    return std::nullopt;
  return notification;
}

namespace {

class Supervisor {
 public:
  Supervisor(int argc, const char* const* argv, std::uint32_t watchdog_seconds, Log& log,
             HiddenSocket socket)
      : log_(log),
        socket_(std::move(socket)),
        outer_(value_of("NOTIFY_SOCKET")),
        watchdog_ms_(std::uint64_t{1'000} * watchdog_seconds) {
    arguments_.assign(argv, argv + argc);
    arguments_.emplace_back("--fd-store=manager");  // the last one counts
    std::array<char, 4096> path{};
    const ssize_t bytes = ::readlink("/proc/self/exe", path.data(), path.size() - 1);
    if (bytes > 0) program_.assign(path.data(), static_cast<std::size_t>(bytes));
    if (auto handed_in = receive_descriptors()) {
      for (HandedIn& one : *handed_in) {
        if (one.name == passed_socket_name) sockets_.push_back(std::move(one.fd));
      }
    }
    // Meant for this process, and not for its children.
    for (const char* const name : {"NOTIFY_SOCKET", "LISTEN_FDS", "LISTEN_PID", "LISTEN_FDNAMES",
                                   "FDSTORE", "WATCHDOG_PID", "WATCHDOG_USEC"})
      ::unsetenv(name);
  }

  int run();

 private:
  void start();
  [[noreturn]] void become_worker(pid_t parent, int life_line) noexcept;
  void on_signals();
  void on_notifications();
  bool receive();
  void keep(const Notification& notification, std::vector<UniqueFd> fds, bool lost);
  void forward(const std::string& line) const noexcept;
  void on_worker_end(int status);
  /// Ends the worker with a signal, and sets when to kill it.
  void end_worker(int signal);
  void kill_worker(std::string_view why);
  void look_at_worker(std::uint64_t now);
  /// Returns whether a killed worker cannot end: a client keeps a thread of it in the kernel.
  bool is_stuck(std::uint64_t now) const noexcept;
  /// Call when a time begins in which the worker has to do something.
  void begin_time() noexcept {
    waited_ns_ = processor_time_of(worker_).waited_ns;
    ran_ns_.reset();
  }
  /// Returns whether that time, which ends at `due_ms`, is over without what the worker has waited
  /// for a processor.
  bool time_is_over(std::uint64_t now, std::uint64_t due_ms) noexcept;
  /// The worker has sent a sign of life, or could not.
  void heard(std::uint64_t now) noexcept {
    heard_ms_ = now;
    watchdog_due_ms_ = now + patience_ms();
    if (!kill_due_ms_) begin_time();
  }
  /// Returns when look_at_worker() is due; nothing: never.
  std::optional<std::uint64_t> look_due_ms() const noexcept;
  std::uint64_t patience_ms() const noexcept {
    return is_ready_ ? watchdog_ms_ : std::max(watchdog_ms_, start_patience_ms);
  }
  void tell_worker(int signal) const noexcept {
    if (worker_ > 0) ::kill(worker_, signal);
  }

  Log& log_;
  HiddenSocket socket_;
  std::string outer_;  // the NOTIFY_SOCKET of the parent process
  std::string program_;
  std::vector<std::string> arguments_;
  UniqueFd signals_;
  std::map<std::string, UniqueFd> kept_;
  std::vector<UniqueFd> sockets_;  // from the parent process, for every worker
  std::size_t kept_limit_ = kept_limit();
  pid_t worker_ = -1;
  UniqueFd life_line_;                 // a pipe: its other end is in the worker's descriptor table
  std::vector<pid_t> remains_;         // workers that hold nothing any more and have not ended
  std::uint64_t watchdog_ms_;          // 0: no watchdog
  std::uint64_t heard_ms_ = 0;         // when the worker last sent a sign of life
  std::uint64_t watchdog_due_ms_ = 0;  // when to look whether it hangs
  std::optional<std::uint64_t> kill_due_ms_;  // when to kill a worker that was asked to end
  std::uint64_t waited_ns_ = 0;               // for a processor, at the last begin_time()
  // How long the worker had run when its time was last found to be over; nothing: it was not.
  std::optional<std::uint64_t> ran_ns_;
  std::optional<std::uint64_t> killed_ms_;
  std::optional<std::uint64_t> remains_since_ms_;  // when it was found to hold nothing any more
  std::uint64_t started_ms_ = 0;
  std::optional<std::uint64_t> due_ms_;  // when the next worker begins
  unsigned failures_ = 0;                // deaths in a row
  unsigned failed_starts_ = 0;           // of those, since a worker was last ready
  bool was_ready_ = false;               // any worker
  bool is_ready_ = false;                // this one
  bool is_stopping_ = false;             // this one has reported it
  bool restarts_ = false;                // the worker was asked to end, and another one is wanted
  bool stops_ = false;
  std::optional<int> result_;
};

int Supervisor::run() {
  sigset_t wanted;
  ::sigemptyset(&wanted);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP, SIGCHLD}) ::sigaddset(&wanted, signal);
  ::sigprocmask(SIG_BLOCK, &wanted, nullptr);
  signals_.reset(::signalfd(-1, &wanted, SFD_CLOEXEC | SFD_NONBLOCK));
  if (!signals_) {
    log_.write(LogLevel::error, "cannot supervise", {{"errno", errno}});
    return 1;
  }
  start();
  while (!result_) {
    int timeout_ms = -1;
    const std::uint64_t now = monotonic_ms();
    if (due_ms_ && now >= *due_ms_) {
      start();
      continue;
    }
    const auto look_due = look_due_ms();
    for (const auto& due : {due_ms_, look_due}) {
      if (!due) continue;
      const auto left = static_cast<int>(*due - std::min(*due, now));
      timeout_ms = timeout_ms < 0 ? left : std::min(timeout_ms, left);
    }
    pollfd entries[] = {{signals_.get(), POLLIN, 0},
                        {socket_.socket.get(), POLLIN, 0},
                        {life_line_.get(), POLLIN, 0}};  // poll() ignores -1
    if (::poll(entries, 3, timeout_ms) < 0 && errno != EINTR) {
      log_.write(LogLevel::error, "cannot supervise", {{"errno", errno}});
      return 1;
    }
    if ((entries[2].revents & POLLHUP) != 0) {
      life_line_.reset();
      remains_since_ms_ = monotonic_ms();
    }
    on_notifications();
    on_signals();
    if (!look_due) continue;
    const std::uint64_t then = monotonic_ms();
    // The supervisor itself was stopped, and so may the worker have been.
    constexpr std::uint64_t late_ms = 1'000;
    if (then > *look_due + late_ms) heard(then);
    if (then >= *look_due) look_at_worker(then);
  }
  return *result_;
}

void Supervisor::start() {
  due_ms_.reset();
  restarts_ = false;
  is_ready_ = is_stopping_ = false;
  kill_due_ms_.reset();
  killed_ms_.reset();
  remains_since_ms_.reset();
  life_line_.reset();
  int line[2] = {-1, -1};
  // Without it a worker that is stuck in the kernel is not seen to be gone; it starts all the
  // same.
  if (::pipe2(line, O_CLOEXEC) == 0) life_line_.reset(line[0]);
  const UniqueFd other_end(line[1]);
  const pid_t parent = ::getpid();
  const pid_t pid = ::fork();
  if (pid == 0) become_worker(parent, other_end.get());
  if (pid < 0) {
    log_.write(LogLevel::error, "worker not started", {{"errno", errno}});
    due_ms_ = monotonic_ms() + pause_most_ms;
    return;
  }
  worker_ = pid;
  started_ms_ = monotonic_ms();
  heard(started_ms_);
  log_.write(LogLevel::debug, "worker started", {{"pid", pid}, {"descriptors", kept_.size()}});
}

// Runs in the child. Signals stay blocked over exec, so early ones are not lost.
void Supervisor::become_worker(pid_t parent, int life_line) noexcept {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) ::_exit(1);  // the supervisor died before prctl()
  std::string names;
  std::vector<int> passed;
  for (const auto& [name, fd] : kept_) {
    names += (names.empty() ? "" : ":") + name;
    passed.push_back(fd.get());
  }
  for (const UniqueFd& socket : sockets_) {
    names += (names.empty() ? "" : ":") + std::string(passed_socket_name);
    passed.push_back(socket.get());
  }
  const auto count = static_cast<int>(passed.size());
  passed.push_back(socket_.way.get());
  if (life_line >= 0) passed.push_back(life_line);
  // First moves descriptors away from the numbers that others have to get.
  const int end = first_passed + static_cast<int>(passed.size());
  for (int& fd : passed) {
    if (fd < end) fd = ::fcntl(fd, F_DUPFD_CLOEXEC, end);
  }
  bool placed = true;
  for (int i = 0; first_passed + i < end; ++i)
    placed = ::dup2(passed[static_cast<std::size_t>(i)], first_passed + i) >= 0 && placed;
  const std::string notify = "/proc/self/fd/" + std::to_string(first_passed + count);
  ::setenv("NOTIFY_SOCKET", notify.c_str(), 1);
  ::setenv(supervisor_variable, std::to_string(parent).c_str(), 1);
  ::setenv("FDSTORE", std::to_string(kept_limit_).c_str(), 1);
  if (watchdog_ms_ > 0) {
    ::setenv("WATCHDOG_USEC", std::to_string(watchdog_ms_ * 1'000).c_str(), 1);
    ::setenv("WATCHDOG_PID", std::to_string(::getpid()).c_str(), 1);
  }
  if (count > 0) {
    ::setenv("LISTEN_FDS", std::to_string(count).c_str(), 1);
    ::setenv("LISTEN_PID", std::to_string(::getpid()).c_str(), 1);
    ::setenv("LISTEN_FDNAMES", names.c_str(), 1);
  }
  std::vector<char*> argv;
  for (std::string& argument : arguments_) argv.push_back(argument.data());
  argv.push_back(nullptr);
  if (placed) {
    ::execv(program_.c_str(), argv.data());
    ::execv("/proc/self/exe", argv.data());  // the file was removed: the supervisor's own program
  }
  say_on_stderr("agnocastd: cannot start " + program_ + ": " + std::strerror(errno) + "\n");
  ::_exit(1);
}

void Supervisor::on_signals() {
  bool child = false;
  signalfd_siginfo info{};
  while (::read(signals_.get(), &info, sizeof info) == sizeof info) {
    switch (info.ssi_signo) {
      case SIGCHLD:
        child = true;
        break;
      case SIGHUP:
        restarts_ = true;
        end_worker(SIGTERM);
        if (due_ms_) due_ms_ = 0;
        break;
      default:
        // SIGINT asks the worker to remove everything; the second SIGTERM kills it at once.
        end_worker(stops_ && info.ssi_signo == SIGTERM ? SIGKILL : SIGINT);
        stops_ = true;
        if (worker_ <= 0) result_ = 0;
    }
  }
  if (child)
    std::erase_if(remains_, [](pid_t pid) { return ::waitpid(pid, nullptr, WNOHANG) != 0; });
  if (!child || worker_ <= 0) return;
  siginfo_t ended{};
  if (::waitid(P_PID, static_cast<id_t>(worker_), &ended, WEXITED | WNOHANG | WNOWAIT) != 0 ||
      ended.si_pid == 0)
    return;
  on_notifications();  // its last datagrams, while its pid is still its own
  int status = 0;
  if (::waitpid(worker_, &status, WNOHANG) == worker_) on_worker_end(status);
}

void Supervisor::end_worker(int signal) {
  tell_worker(signal);
  if (worker_ <= 0) return;
  const std::uint64_t now = monotonic_ms();
  if (signal == SIGKILL) {
    killed_ms_ = now;
  } else if (!kill_due_ms_) {
    kill_due_ms_ = now + stop_patience_ms;
    begin_time();
  }
}

void Supervisor::kill_worker(std::string_view why) {
  log_.write(LogLevel::error, "worker killed", {{"pid", worker_}, {"why", why}});
  end_worker(SIGKILL);
}

std::optional<std::uint64_t> Supervisor::look_due_ms() const noexcept {
  if (worker_ <= 0) return std::nullopt;
  if (killed_ms_ || kill_due_ms_ || remains_since_ms_) return monotonic_ms() + look_interval_ms;
  if (watchdog_ms_ == 0) return std::nullopt;
  return watchdog_due_ms_;
}

bool Supervisor::time_is_over(std::uint64_t now, std::uint64_t due_ms) noexcept {
  if (now < due_ms) return false;
  if (now >= due_ms + wait_most_ms) return true;
  const ProcessorTime time = processor_time_of(worker_);
  const std::uint64_t waited_ms =
      (time.waited_ns - std::min(time.waited_ns, waited_ns_)) / 1'000'000;
  if (now < due_ms + waited_ms) {
    ran_ns_.reset();
    return false;
  }
  // The wait that it may be in does not count yet: it is ready, and has not run since the last
  // look. A loop that spins has.
  const bool has_run = ran_ns_ && time.ran_ns != *ran_ns_;
  ran_ns_ = time.ran_ns;
  return has_run || time.ran_ns == 0 || state_of_first_thread(worker_) != 'R';
}

void Supervisor::look_at_worker(std::uint64_t now) {
  if (worker_ <= 0) return;
  if (remains_since_ms_ ? now >= *remains_since_ms_ + remains_patience_ms : is_stuck(now)) {
    log_.write(LogLevel::warning, "worker does not end",
               {{"pid", worker_}, {"why", "a thread of it has not ended yet"}});
    tell_worker(SIGKILL);
    remains_.push_back(worker_);
    on_notifications();  // its last datagrams
    return on_worker_end(is_stopping_ && !killed_ms_ ? 0 : SIGKILL);
  }
  if (remains_since_ms_) return;
  if (!killed_ms_ && kill_due_ms_ && time_is_over(now, *kill_due_ms_))
    return kill_worker("it was asked to end and does not");
  if (!killed_ms_ && !kill_due_ms_ && watchdog_ms_ > 0) {
    if (time_is_over(now, heard_ms_ + patience_ms()))
      return kill_worker(is_ready_ ? "its loop does not run" : "it does not begin to serve");
    watchdog_due_ms_ = std::max(watchdog_due_ms_, now + look_interval_ms);
  }
  if (killed_ms_ && stops_ && now >= *killed_ms_ + kill_patience_ms) result_ = 1;
}

// If a thread had to stay in the worker's own table, the life line shows nothing.
bool Supervisor::is_stuck(std::uint64_t now) const noexcept {
  return killed_ms_ && now >= *killed_ms_ + remains_patience_ms && first_thread_has_ended(worker_);
}

void Supervisor::on_worker_end(int status) {
  const pid_t pid = std::exchange(worker_, -1);
  const bool clean = WIFEXITED(status) && WEXITSTATUS(status) == 0;
  if (stops_ || (clean && !restarts_)) {
    result_ = WIFEXITED(status) ? WEXITSTATUS(status) : 1;
    return;
  }
  if (!was_ready_ && !restarts_) {
    if (!WIFEXITED(status))
      log_.write(LogLevel::error, "worker died", {{"pid", pid}, {"signal", WTERMSIG(status)}});
    result_ = WIFEXITED(status) ? WEXITSTATUS(status) : 1;
    return;
  }
  if (restarts_) {
    failures_ = failed_starts_ = 0;
    due_ms_ = 0;
    return;
  }
  const std::uint64_t lived_ms = monotonic_ms() - started_ms_;
  if (lived_ms >= settled_ms) failures_ = failed_starts_ = 0;
  failed_starts_ = is_ready_ ? 0 : failed_starts_ + 1;
  const std::uint64_t pause = pause_after(failures_, failed_starts_, lived_ms);
  ++failures_;
  due_ms_ = monotonic_ms() + pause;
  log_.write(LogLevel::error, "worker died",
             {{"pid", pid},
              {WIFEXITED(status) ? "status" : "signal",
               WIFEXITED(status) ? WEXITSTATUS(status) : WTERMSIG(status)},
              {"failures", failures_},
              {"descriptors", kept_.size()},
              {"again_in_ms", pause}});
  if (failures_ > 1)
    forward("STATUS=the daemon died " + std::to_string(failures_) + " times in a row");
}

// --- the store

void Supervisor::on_notifications() {
  while (receive()) {
  }
}

bool Supervisor::receive() {
  std::array<char, datagram_bytes_max> text;
  iovec data{text.data(), text.size()};
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(ucred)) +
                                        CMSG_SPACE(sizeof(int) * descriptors_per_datagram_max)>
      control;
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  const ssize_t bytes = ::recvmsg(socket_.socket.get(), &message, MSG_DONTWAIT | MSG_CMSG_CLOEXEC);
  if (bytes < 0) return errno == EINTR;
  std::vector<UniqueFd> fds;
  pid_t sender = 0;
  for (cmsghdr* part = CMSG_FIRSTHDR(&message); part != nullptr;
       part = CMSG_NXTHDR(&message, part)) {
    if (part->cmsg_level != SOL_SOCKET) continue;
    if (part->cmsg_type == SCM_RIGHTS) {
      const std::size_t count = (part->cmsg_len - CMSG_LEN(0)) / sizeof(int);
      for (std::size_t i = 0; i < count; ++i) {
        int fd = -1;
        std::memcpy(&fd, CMSG_DATA(part) + i * sizeof fd, sizeof fd);
        fds.emplace_back(fd);
      }
    } else if (part->cmsg_type == SCM_CREDENTIALS) {
      ucred credentials{};
      std::memcpy(&credentials, CMSG_DATA(part), sizeof credentials);
      sender = credentials.pid;
    }
  }
  const auto notification = parse_notification({text.data(), static_cast<std::size_t>(bytes)});
  if (sender != worker_ || worker_ <= 0 || (message.msg_flags & MSG_TRUNC) != 0 || !notification) {
    log_.write_limited("notification", LogLevel::warning, "notification passed over",
                       {{"pid", sender}, {"bytes", bytes}});
    return true;
  }
  keep(*notification, std::move(fds), (message.msg_flags & MSG_CTRUNC) != 0);
  return true;
}

void Supervisor::keep(const Notification& notification, std::vector<UniqueFd> fds, bool lost) {
  if (notification.remove) kept_.erase(notification.name);
  if (notification.store) {
    for (UniqueFd& fd : fds) {
      if (kept_.size() < kept_limit_ || kept_.count(notification.name) != 0) {
        kept_.insert_or_assign(notification.name, std::move(fd));
      } else {
        lost = true;
      }
    }
    if (lost || fds.empty())
      log_.write(
          LogLevel::error, "a descriptor was lost",
          {{"name", notification.name}, {"why", "the store is full, or LimitNOFILE is too low"}});
  }
  if (notification.ready) was_ready_ = is_ready_ = true;
  if (notification.ready || notification.watchdog) heard(monotonic_ms());
  is_stopping_ = is_stopping_ || notification.stopping;
  if (notification.stopping && kill_due_ms_) kill_due_ms_ = monotonic_ms() + end_patience_ms;
  std::string notification_text = notification.ready ? "READY=1\n" : "";
  if (!notification.status.empty()) notification_text += "STATUS=" + notification.status;
  if (!notification_text.empty()) forward(notification_text);
  if (notification.stopping && stops_) forward("STOPPING=1");
}

// Never waits for the parent process.
void Supervisor::forward(const std::string& line) const noexcept {
  if (outer_.empty() || (outer_[0] != '/' && outer_[0] != '@')) return;
  sockaddr_un address{};
  if (outer_.size() >= sizeof address.sun_path) return;
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, outer_.data(), outer_.size());
  if (outer_[0] == '@') address.sun_path[0] = '\0';
  const UniqueFd fd(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  static_cast<void>(::sendto(
      fd.get(), line.data(), line.size(), MSG_NOSIGNAL, reinterpret_cast<const sockaddr*>(&address),
      static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + outer_.size())));
}

}  // namespace

// exec of a program with file capabilities clears an earlier PR_SET_PDEATHSIG.
bool die_with_supervisor() noexcept {
  const char* const supervisor = std::getenv(supervisor_variable);
  if (supervisor == nullptr) return true;
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  return std::to_string(::getppid()) == supervisor;
}

int supervise(int argc, const char* const* argv, std::uint32_t watchdog_seconds, Log& log) {
  auto socket = hidden_socket();
  if (!socket) {
    log.write(LogLevel::error, "cannot supervise",
              {{"why", "found no directory for its socket"}, {"errno", errno}});
    return 1;
  }
  return Supervisor(argc, argv, watchdog_seconds, log, std::move(*socket)).run();
}

}  // namespace agnocast::daemon
