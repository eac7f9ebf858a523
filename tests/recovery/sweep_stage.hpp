// SPDX-License-Identifier: Apache-2.0
//
// SweepStage: a daemon and processes of sweep_actor, all with crash points and a control page each
// that the test writes; and a view of everything the daemon knows, as agnocast-ctl has it.
//
// No gtest expectations here, because several threads use stages: errors are returned as text.
#pragma once

#include <base/descriptors/pidfd.hpp>
#include <base/memory/mapping.hpp>
#include <base/sockets/packet_socket.hpp>
#include <ctl/snapshot/audit.hpp>
#include <ctl/snapshot/system.hpp>
#include <tests/support/crash/crash_point.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>
#include <tests/support/wire/listen_at.hpp>

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <system_error>
#include <utility>

namespace agnocast::sweep {

/// A control page in a file, used by one process after another.
class ControlPage {
 public:
  explicit ControlPage(std::string path) : path_(std::move(path)) {
    const UniqueFd file(::open(path_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
    if (::ftruncate(file.get(), abi::page_bytes) != 0) std::abort();
    mapping_ = Mapping::map(file.get(), abi::page_bytes, Mapping::Access::read_write).value();
  }
  const std::string& path() const { return path_; }
  /// The process dies at the n-th point from now on; 0 = it only counts. `then`: its successor on
  /// this page dies so many points later.
  void arm(std::uint64_t n, std::uint64_t then = 0) {
    words().last.store(0);
    words().deadly.store(0);
    words().from.store(0);
    words().until.store(0);
    words().reached.store(0);
    words().then.store(then);
    words().deadly.store(n);
  }
  /// Like arm(), counted from the next time that it reaches this step.
  void arm_from(Step step, std::uint64_t n, std::uint64_t then = 0) {
    arm(0, then);
    words().from.store(static_cast<std::uint64_t>(step) + 1);
    words().deadly.store(n);
  }
  /// Like arm_from(), but counting ends when it reaches `until`.
  void arm_between(Step step, Step until, std::uint64_t n) {
    arm(0);
    words().until.store(static_cast<std::uint64_t>(until) + 1);
    words().from.store(static_cast<std::uint64_t>(step) + 1);
    words().deadly.store(n);
  }
  /// Counts from now on until it reaches `until`.
  void arm_until(Step until, std::uint64_t n) {
    arm(0);
    words().until.store(static_cast<std::uint64_t>(until) + 1);
    words().deadly.store(n);
  }
  /// The daemon has ended: if counting had begun, it ends too. The next one would die before it
  /// serves, and its supervisor would end then.
  void end_count() {
    if (words().from.load() == 0 && words().until.load() != 0) disarm();
  }
  void disarm() {
    words().deadly.store(0);
    words().then.store(0);
    words().from.store(0);
    words().until.store(0);
  }
  /// Delays it from now on at so many of a million points, chosen by the seed. 0: at none.
  void slow_down(std::uint64_t seed, std::uint64_t points_per_million) {
    words().sleeps.store(points_per_million);
    words().seed.store(seed);
  }
  std::uint64_t reached() const { return words().reached.load(); }
  /// Returns the commits of its main thread since the page exists.
  std::uint64_t commits() const { return words().commits.load(); }
  /// Returns where it died, if at a crash point.
  std::optional<Step> died_at() const {
    const std::uint64_t last = words().last.load();
    if (last == 0) return std::nullopt;
    return static_cast<Step>(last - 1);
  }

 private:
  crash_points::Control& words() const {
    return *reinterpret_cast<crash_points::Control*>(mapping_.base());
  }
  std::string path_;
  Mapping mapping_;
};

/// One process, driven line by line.
class SweepProcess {
 public:
  SweepProcess(PacketSocket socket, pid_t pid)
      : socket_(std::move(socket)), pid_(pid), process_(Pidfd::open(pid).value_or(Pidfd())) {}

  pid_t pid() const { return pid_; }
  /// Returns the answer, or nothing if the process died.
  std::optional<std::string> ask(const std::string& line) {
    if (!tell(line)) return std::nullopt;
    pollfd readable{socket_.fd(), POLLIN, 0};
    if (::poll(&readable, 1, patience_ms) <= 0) return "bad: no answer within 20 s";
    std::array<std::byte, 4096> buffer;
    const auto packet = socket_.receive(buffer);
    if (!packet || packet->kind != Packet::Kind::data) return std::nullopt;
    return std::string(reinterpret_cast<const char*>(buffer.data()), packet->bytes - 1);
  }
  bool tell(const std::string& line) {
    const auto sent = socket_.send(std::as_bytes(std::span(line.data(), line.size())));
    return sent && *sent == Sent::sent;
  }
  bool is_dead() const { return wait(0); }
  void signal(int number) const { ::kill(pid_, number); }
  bool wait_for_end() const { return wait(patience_ms); }

 private:
  static constexpr int patience_ms = 20'000;
  bool wait(int timeout_ms) const {
    if (process_.fd() < 0) return true;  // it ended before it could be watched
    pollfd over{process_.fd(), POLLIN, 0};
    return ::poll(&over, 1, timeout_ms) > 0;
  }
  PacketSocket socket_;
  pid_t pid_;
  Pidfd process_;
};

class SweepStage {
 public:
  SweepStage()
      : directory_(test::make_directory()),
        daemon_control_(directory_ + "/daemon"),
        daemon_(std::make_unique<test::DaemonProcess>(daemon_options())),
        listener_(test::listen_at(directory_ + "/actors").value()),
        maker_({AGNOCAST_SWEEP_ACTOR},
               {"AGNOCAST_SOCKET=" + daemon_->socket_path(), "LD_PRELOAD=" AGNOCAST_HOOK}) {}
  ~SweepStage() {
    observer_.reset();
    maker_.kill();
    test::remove_directory(directory_);
  }

  test::DaemonProcess& daemon() { return *daemon_; }
  ControlPage& daemon_control() { return daemon_control_; }
  const std::string& directory() const { return directory_; }

  /// Makes a process of this user; 0: of the user that runs the test.
  std::unique_ptr<SweepProcess> make(const ControlPage& control, uid_t uid = 0) {
    const std::string answer =
        maker_.ask("spawn " + directory_ + "/actors " + control.path() + " " + std::to_string(uid));
    const pid_t pid = static_cast<pid_t>(std::atoi(answer.c_str()));
    pollfd waiting{listener_.fd(), POLLIN, 0};
    if (pid <= 0 || ::poll(&waiting, 1, 20'000) <= 0) std::abort();
    return std::make_unique<SweepProcess>(std::move(*listener_.accept().value()), pid);
  }

  /// Returns what the daemon knows, as soon as there is a daemon.
  ctl::System look_in_time() {
    ctl::System system;
    (void)test::eventually([&] { return (system = look()).daemon.pid != 0; });
    return system;
  }
  /// Returns what the daemon knows now; nothing if there is no daemon.
  ctl::System look() {
    if (!observer_) {
      auto connected = ctl::Observer::connect(daemon_->socket_path());
      if (!connected) return {};
      observer_.emplace(std::move(*connected));
    }
    auto system = observer_->look();
    if (system) return std::move(*system);
    observer_.reset();
    return {};
  }
  /// Returns the broken invariants; empty if all hold. Decided as in agnocast-ctl verify: broken
  /// is what several looks find with the same words.
  std::string verify() {
    std::set<ctl::Finding> broken;
    for (int looks = 0; looks < 6; ++looks) {
      const ctl::System system = look_in_time();
      if (!observer_) return "the daemon does not answer";
      const ctl::Audit audit = ctl::audit(system, observer_->region_bytes());
      if (looks == 0) {
        broken = audit.findings;
      } else {
        ctl::keep_what_lasts(broken, audit);
      }
      if (broken.empty()) return {};
      ::usleep(20'000u << looks);
    }
    std::string text;
    for (const ctl::Finding& finding : broken)
      text += finding.where + ": " + journal::sentence_of(finding.invariant) + "; ";
    return text;
  }
  /// Returns whether the daemon has accepted all earlier connections and handled the death of this
  /// process.
  bool wait_until_recovered(pid_t dead) {
    observer_.reset();  // a new one waits in the queue behind the dead
    return test::eventually([&] {
      const ctl::System system = look();
      if (!observer_) return false;
      for (const auto& [index, process] : system.processes) {
        if (static_cast<pid_t>(process.facts.pid) == dead &&
            process.facts.state != ctl::wire::ProcessState::dead)
          return false;
      }
      return system.daemon.connections == living_;
    });
  }
  /// Revokes the session of a living process, however many daemons it takes. Also returns true if
  /// the process has no session any more.
  bool revoke(pid_t pid) {
    return test::eventually([&] {
      const ctl::System system = look();
      if (!observer_) return false;
      for (const auto& [index, process] : system.processes) {
        using State = ctl::wire::ProcessState;
        const State state = process.facts.state;
        if (static_cast<pid_t>(process.facts.pid) != pid || state == State::dead ||
            state == State::revoked)
          continue;
        if (!observer_->revoke(process.facts)) observer_.reset();
        return false;  // look again
      }
      return true;
    });
  }
  /// Returns whether the daemon has revoked this process but keeps its place.
  bool is_revoked(pid_t pid) {
    for (const auto& [index, process] : look_in_time().processes) {
      if (static_cast<pid_t>(process.facts.pid) == pid)
        return process.facts.state == ctl::wire::ProcessState::revoked;
    }
    return false;
  }
  /// Kills the daemon; returns whether the next one serves.
  bool restart() {
    const std::uint32_t former = look_in_time().daemon.pid;
    if (former == 0) return false;
    ::kill(static_cast<pid_t>(former), SIGKILL);
    return test::eventually([&] {
      const std::uint32_t pid = look().daemon.pid;
      return pid != 0 && pid != former;
    });
  }
  /// Removes the names of all doorbells, as a cleaner of temporary files does, and kills the
  /// daemon. Calls `arm` when this daemon's points no longer count and the next one's do not yet.
  /// Returns false if there was no name, or no daemon serves afterwards.
  bool remove_doorbells_and_restart(const std::function<void(ControlPage&)>& arm) {
    const std::set<std::string> names = doorbell_names();
    const auto former = static_cast<pid_t>(look_in_time().daemon.pid);
    observer_.reset();
    ::kill(former, SIGSTOP);
    for (const std::string& name : names) ::unlink((doorbells_directory() + "/" + name).c_str());
    arm(daemon_control_);
    ::kill(former, SIGKILL);
    return !names.empty() && daemon_->wait_for_next(former);
  }
  std::set<std::string> doorbell_names() const {
    std::set<std::string> names;
    std::error_code gone;
    for (const auto& name : std::filesystem::directory_iterator(doorbells_directory(), gone))
      names.insert(name.path().filename().string());
    return names;
  }
  /// Kills supervisor and daemon.
  void end_daemon() {
    observer_.reset();
    daemon_.reset();
  }
  /// Starts another daemon at the same place, which knows no process.
  void begin_daemon() { daemon_ = std::make_unique<test::DaemonProcess>(daemon_options()); }
  /// Does both. The new daemon dies at its n-th point after it first reaches this step.
  void lose(Step step, std::uint64_t n) {
    end_daemon();
    daemon_control_.arm_from(step, n);
    begin_daemon();
  }
  /// Sets how many processes are connected when all others are gone.
  void set_living(std::uint64_t count) { living_ = count; }

 private:
  std::string doorbells_directory() const { return daemon_->socket_path() + ".bells"; }
  test::DaemonOptions daemon_options() const {
    return {.config =
                "[daemon]\nsocket_mode = \"0666\"\n[limits]\ndepth_max = 100\n"
                "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"4GiB\"\n",
            .arguments = {"--log-level", "debug"},
            .socket = directory_ + "/agnocastd.sock",
            .program = AGNOCAST_CRASH_DAEMON,
            .environment = {"AGNOCAST_CRASH_CONTROL=" + daemon_control_.path()}};
  }

  std::string directory_;
  ControlPage daemon_control_;
  std::unique_ptr<test::DaemonProcess> daemon_;
  PacketListener listener_;
  test::SteeredProcess maker_;
  std::optional<ctl::Observer> observer_;
  std::uint64_t living_ = 0;
};

}  // namespace agnocast::sweep
