// SPDX-License-Identifier: Apache-2.0
//
// Performance: a script of commands to three processes (sweep_actor), run without a death and with
// the death of one of them, and the comparison of the two.
//
//   "A sub 1 /s 20; sync; V pub 2 /s 20; …"     V may die; A and B live until the script ends.
//       Ids are unique in the script. "sync": all who live. "V arm": points count from now.
//       "revoke": an observer revokes V's session. "restart": the daemon dies, another resumes.
//       "lose": also its store; the next knows no process. "connected", "moved", "settled": wait
//       (sweep_actor). "A stop", "A cont": SIGSTOP, SIGCONT; all continue when V dies.
//
// The death of V may change only the following:
//   - V's later commands are not given;
//   - from each of V's publishers a subscription of A or B gets a prefix of what it gets without
//     the death. The prefix has every message whose publish had returned or was seen after its
//     commit, if the subscription existed before V's last answer; beyond that at most what the
//     interrupted publish was committing;
//   - so a take may find no message, and a release nothing to release.
// What A and B get from each other is the same, in the same order.
#pragma once

#include <tests/recovery/sweep_run.hpp>
#include <tests/recovery/sweep_stage.hpp>
#include <tests/support/crash/step_names.hpp>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::sweep {

class Performance {
 public:
  Performance(SweepStage& stage, const Script& script)
      : stage_(stage),
        commands_(parse(script.commands)),
        loses_store_(script.loses_store()),
        control_(stage.directory() + "/victim") {
    for (const Command& command : commands_) {
      if (command.what == "pub") publishers_[command.id] = {command.who, command.topic};
    }
  }

  /// Runs the script without a death to warm up; then again as the reference for every other run.
  /// Returns what is wrong, or nothing.
  std::string rehearse() {
    for (const char who : {'A', 'B'}) {
      const bool plays = std::any_of(commands_.begin(), commands_.end(),
                                     [&](const Command& command) { return command.who == who; });
      if (!plays) continue;
      pages_.push_back(std::make_unique<ControlPage>(stage_.directory() + "/" + who));
      remaining_peers_[who] = stage_.make(*pages_.back());
    }
    stage_.set_living(remaining_peers_.size());
    for (int i = 0; i < 2; ++i) {
      stage_.daemon_control().arm(0);
      daemon_deadly_ = {0, 0};
      reference_ = play(0);
      daemon_deadly_.reset();
      if (!reference_.wrong.empty()) return "rehearsal: " + reference_.wrong;
      if (i == 0) {
        baseline_ = state_at_rest();
        descriptors_ = stage_.daemon().descriptor_count();
      }
    }
    daemon_points_ = stage_.daemon_control().reached();
    points_ = control_.reached();
    return {};
  }
  /// Returns the number of V's crash points in a run without a death.
  std::uint64_t points() const { return points_; }

  /// Returns the number of the daemon's crash points in that run.
  std::uint64_t daemon_points() const { return daemon_points_; }

  struct Ended {
    std::optional<Step> died_at;
    std::string wrong;
    // For a pair:
    std::optional<Step> daemon_died_at = {};
    std::uint64_t reap_points = 0;
  };
  /// Kills the daemon at its n-th point, and the next one `then` points later. No process notices.
  /// In a script that loses the store: the daemon that starts then, at its own points.
  Ended perform_daemon(std::uint64_t n, std::uint64_t then) {
    stage_.daemon_control().arm(loses_store_ ? 0 : n, loses_store_ ? 0 : then);
    daemon_deadly_ = {n, then};
    Ended ended = perform_without_victim();
    daemon_deadly_.reset();
    return ended;
  }
  /// Kills V at its n-th point, and the daemon at the m-th point of the reap; m = 0: the daemon
  /// lives, and the points are counted.
  Ended perform_pair(std::uint64_t n, std::uint64_t m) {
    stage_.daemon_control().arm_between(steps::B_reap, steps::B_reaped, m);
    return perform_both(n);
  }
  /// Kills V when it first reaches this step, and the daemon as above.
  Ended perform_pair_from(Step step, std::uint64_t m) {
    from_ = step;
    Ended ended = perform_pair(1, m);
    from_.reset();
    return ended;
  }
  /// Kills both when they first reach these steps.
  Ended perform_pair_at(Step step, Step of_daemon) {
    from_ = step;
    stage_.daemon_control().arm_from(of_daemon, 1);
    Ended ended = perform_both(1);
    from_.reset();
    return ended;
  }
  /// Kills the daemon at the n-th point after it next reaches this step.
  Ended perform_daemon_from(Step step, std::uint64_t n) {
    stage_.daemon_control().arm_from(step, n);
    return perform_without_victim();
  }
  /// Kills V when it first reaches this step.
  Ended perform_from(Step step) {
    from_ = step;
    Ended ended = perform(1);
    from_.reset();
    return ended;
  }
  /// Delays processes and daemon from now on at so many of a million points, chosen by seed.
  void slow_down(std::uint64_t seed, std::uint64_t points_per_million) {
    for (const auto& page : pages_) page->slow_down(seed++, points_per_million);
    control_.slow_down(seed++, points_per_million);
    stage_.daemon_control().slow_down(seed, points_per_million);
  }
  /// Runs without a death; delays must change no result.
  std::string perform_slowly(std::uint64_t seed, std::uint64_t points_per_million) {
    slow_down(seed, points_per_million);
    const Run run = play(0);
    slow_down(0, 0);
    return run.wrong.empty() ? compare_answers(run) : run.wrong;
  }
  /// Kills V at its n-th point; then runs everything again without a death.
  Ended perform(std::uint64_t n) {
    Run run = play(n);
    Ended ended{control_.died_at(), std::move(run.wrong)};
    if (ended.wrong.empty()) ended.wrong = compare(run);
    if (!ended.wrong.empty() || !ended.died_at) return ended;
    run = play(0);
    ended.wrong = run.wrong.empty() ? compare_answers(run) : run.wrong;
    if (!ended.wrong.empty()) ended.wrong = "afterwards: " + ended.wrong;
    return ended;
  }

 private:
  Ended perform_both(std::uint64_t n) {
    daemon_dies_ = true;
    Ended ended = perform(n);
    ended.reap_points = stage_.daemon_control().reached();
    stage_.daemon_control().disarm();
    if (ended.died_at) ended.daemon_died_at = stage_.daemon_control().died_at();
    if (ended.wrong.empty()) ended.wrong = lost();
    return ended;
  }
  Ended perform_without_victim() {
    daemon_dies_ = true;
    const Run run = play(0);
    stage_.daemon_control().disarm();
    Ended ended{stage_.daemon_control().died_at(), run.wrong};
    if (ended.wrong.empty()) ended.wrong = compare_answers(run);
    if (ended.wrong.empty()) ended.wrong = stage_.verify();
    if (ended.wrong.empty()) ended.wrong = lost();
    return ended;
  }
  /// The next daemon must find everything that it needs of a process.
  std::string lost() const {
    const bool is_lost = stage_.daemon().log().find(" client lost ") != std::string::npos;
    return is_lost ? "the kept state of a process is incomplete" : "";
  }

  struct Publisher {
    char owner;
    std::string topic;
  };

  Run play(std::uint64_t n) {
    Run run;
    run.answers.resize(commands_.size());
    left_something_ = revoked_ = false;
    windows_before_.clear();
    const bool armed_later = std::any_of(commands_.begin(), commands_.end(),
                                         [](const Command& c) { return c.text == "arm"; });
    arm(armed_later ? 0 : n);
    for (at_ = 0; at_ < commands_.size() && run.wrong.empty(); ++at_) {
      const Command& command = commands_[at_];
      if (command.what.rfind("un", 0) == 0) left_something_ = true;
      if (victim_ != nullptr && !run.noticed_dead && victim_->is_dead()) mourn(run);
      if (command.what == "revoke") {
        revoke(run);
      } else if (command.what == "restart") {
        run.answers[at_] = "another";
        if (!stage_.restart()) complain(run, "no daemon goes on");
      } else if (command.what == "lose") {
        lose_store(run);
      } else if (command.who == '*' && command.what != "sync") {
        await_everybody(command.what, run);
      } else if (command.text == "stop" || command.text == "cont") {
        run.answers[at_] = command.text;
        remaining_peers_.at(command.who)->signal(command.text == "stop" ? SIGSTOP : SIGCONT);
        stopped_.clear();
        if (command.text == "stop") stopped_.insert(command.who);  // one at a time
      } else if (command.who == '*') {
        sync(run);
      } else if (command.who != 'V') {
        tell_remaining_peer(command, run);
      } else if (!run.noticed_dead) {
        tell_victim(command, n, run);
      }
    }
    if (victim_ != nullptr && run.wrong.empty()) run.wrong = "the script does not end V";
    victim_.reset();
    at_ = commands_.size() - 1;
    if (run.wrong.empty() && loses_store_) await_everybody("settled", run);
    if (run.wrong.empty()) await_nothing_left(run);
    return run;
  }

  void arm(std::uint64_t n) {
    if (from_ && n != 0) {
      control_.arm_from(*from_, n);
    } else {
      control_.arm(n);
    }
  }

  void tell_victim(const Command& command, std::uint64_t n, Run& run) {
    if (command.text == "arm") return arm(n);
    if (victim_ == nullptr) victim_ = stage_.make(control_);
    if (command.text == "connected") await_registration();
    if (command.text == "quit") {
      run.answers[at_] = "quit";
      if (revoked_ && !stage_.is_revoked(victim_->pid()) && !victim_->is_dead())
        return complain(run, "its place is not kept while it lives");
      victim_->tell("quit");
      if (!victim_->wait_for_end()) run.wrong = "V does not end";
      mourn(run, control_.died_at().has_value());
      return;
    }
    const std::uint64_t commits = control_.commits();
    const auto answer = victim_->ask(command.text);
    if (!answer) {
      if (publishes(command)) {
        run.interrupted[command.id] = command.count();
        run.committed = control_.commits() - commits;
      }
      return mourn(run);
    }
    run.answers[at_] = *answer;
    run.last_answer = at_;
    if (answer->find("bad") != std::string::npos) return complain(run, *answer);
    if (command.what == "later") run.interrupted[command.id] = command.count();  // until done
    if (command.what == "done") run.interrupted.erase(command.id);
    if (publishes(command))
      run.acknowledged[command.id] += std::strtoull(answer->c_str(), nullptr, 10);
  }
  /// V lives and keeps its place until it ends.
  void revoke(Run& run) {
    left_something_ = revoked_ = true;
    run.answers[at_] = "revoked";
    if (victim_ == nullptr) return;
    if (!stage_.revoke(victim_->pid())) return complain(run, "it keeps its session");
    if (const std::string broken = stage_.verify(); !broken.empty()) complain(run, broken);
  }
  /// When all are back, the windows of all processes are at their old addresses.
  void lose_store(Run& run) {
    run.answers[at_] = "lost";
    if (windows_before_.empty()) windows_before_ = windows();
    stage_.end_daemon();
    stage_.daemon_control().end_count();
    // A daemon that dies before it served ends its supervisor: from the first connection on.
    if (daemon_deadly_)
      stage_.daemon_control().arm_from(steps::B_accepted, daemon_deadly_->first,
                                       daemon_deadly_->second);
    stage_.begin_daemon();
  }
  void await_everybody(const std::string& what, Run& run) {
    run.answers[at_] = what;
    await_registration();
    for (auto& [who, remaining_peer] : remaining_peers_) {
      const std::string answer = remaining_peer->ask(what).value_or("it has ended");
      if (answer != "ok") return complain(run, std::string(1, who) + ": " + answer);
    }
    if (victim_ != nullptr) {
      const auto answer = victim_->ask(what);
      if (!answer) return mourn(run);
      if (*answer != "ok") return complain(run, "V: " + *answer);
    }
    for (const auto& [who, bases] : windows()) {
      const auto before = windows_before_.find(who);
      if (before == windows_before_.end()) continue;
      const auto& wanted = before->second;
      if (bases.size() < wanted.size() || !std::equal(wanted.begin(), wanted.end(), bases.begin()))
        complain(run, std::string(1, who) + "'s windows are not where they were");
    }
    windows_before_.clear();
  }
  // A process that has not yet noticed the loss still reports that it is connected.
  void await_registration() {
    (void)test::eventually([&] {
      const auto all = windows();
      const bool has_victim = victim_ == nullptr || all.count('V') != 0 || victim_->is_dead();
      return has_victim &&
             std::all_of(remaining_peers_.begin(), remaining_peers_.end(), [&](const auto& entry) {
               return all.count(entry.first) != 0 || stopped_.count(entry.first) != 0;
             });
    });
  }
  /// Returns the windows' addresses by process.
  std::map<char, std::vector<std::uint64_t>> windows() {
    std::map<char, std::vector<std::uint64_t>> all;
    for (const auto& [index, process] : stage_.look_in_time().processes) {
      if (process.facts.state == ctl::wire::ProcessState::dead) continue;
      auto& bases = all[name_of_process(process.facts.pid)];
      for (std::uint32_t w = 0; w < process.facts.window_count; ++w)
        bases.push_back(process.facts.window[w].base);
    }
    return all;
  }
  static bool publishes(const Command& command) {
    return command.what == "publish" || command.what == "commit" || command.what == "later" ||
           command.what == "done" || command.what == "foreign" || command.what == "big";
  }

  /// V is dead: the daemon must handle that before the script continues.
  void mourn(Run& run, bool by_crash = true) {
    for (const auto& [who, remaining_peer] : remaining_peers_) remaining_peer->signal(SIGCONT);
    stopped_.clear();
    if (!victim_->wait_for_end()) run.wrong = "V neither answers nor ends";
    if (by_crash && !control_.died_at()) return complain(run, "V ended, and not at a crash point");
    if (by_crash) run.noticed_dead = at_;
    const pid_t pid = victim_->pid();
    victim_.reset();
    if (!stage_.wait_until_recovered(pid)) return complain(run, "the daemon does not recover");
    if (const std::string broken = stage_.verify(); !broken.empty()) return complain(run, broken);
    sync(run);
  }

  void tell_remaining_peer(const Command& command, Run& run) {
    if (command.what == "sub" || command.what == "others" || command.what == "cb")
      run.joined[command.id] = at_;
    SweepProcess& remaining_peer = *remaining_peers_.at(command.who);
    std::string answer;
    const auto ask = [&] {
      answer = remaining_peer.ask(command.text).value_or("bad: it has ended");
      return answer.rfind("bad", 0) == 0 || command.what != "heard" ||
             count_of(answer) >= expected(command.id, run);
    };
    if (!test::eventually(ask)) complain(run, "not heard in time: " + answer);
    run.answers[at_] = answer;
    if (answer.find("bad") != std::string::npos) return complain(run, answer);
    if (command.what == "take" || command.what == "drain" || command.what == "heard")
      note(command.id, answer, run);
  }
  static std::size_t count_of(const std::string& names) {
    return static_cast<std::size_t>(std::count(names.begin(), names.end(), ':'));
  }
  /// Returns how many messages a callback must have: it joined first, and none may be lost.
  std::size_t expected(std::uint64_t subscription, const Run& run) const {
    const auto joined = std::find_if(commands_.begin(), commands_.end(), [&](const Command& c) {
      return c.id == subscription && c.what == "cb";
    });
    std::size_t count = 0;
    for (const auto& [publisher, whose] : publishers_) {
      if (whose.topic == joined->topic) count += committed_by(run, publisher);
    }
    return count;
  }
  /// Returns how many messages must arrive: publish has returned, or V died after the commit.
  static std::uint64_t committed_by(const Run& run, std::uint64_t publisher) {
    const bool is_interrupted = number_in(run.interrupted, publisher) > 0;
    return number_in(run.acknowledged, publisher) + (is_interrupted ? run.committed : 0);
  }
  void note(std::uint64_t subscription, const std::string& answer, Run& run) const {
    std::istringstream names(answer);
    for (std::string name; names >> name;) {
      const std::size_t colon = name.find(':');
      if (colon == std::string::npos) continue;
      Run::Names& got = run.got[subscription][std::stoull(name)];
      const std::uint64_t number = std::stoull(name.substr(colon + 1));
      if (!got.empty() && got.back() >= number)
        complain(run, name + " comes twice, or after a newer one");
      got.push_back(number);
    }
  }

  void sync(Run& run) {
    for (auto& [who, remaining_peer] : remaining_peers_) {
      const std::string answer = remaining_peer->ask("sync").value_or("it has ended");
      if (answer != "ok") return complain(run, std::string(1, who) + " sync: " + answer);
    }
    if (victim_ != nullptr) {
      const auto answer = victim_->ask("sync");
      if (!answer) return mourn(run);
      if (*answer != "ok") return complain(run, "V sync: " + *answer);
    }
    // Compares places, unless a process is about to leave.
    if (run.wrong.empty() && commands_[at_].who == '*' && !left_something_ && !run.noticed_dead)
      run.answers[at_] = state();
  }

  void complain(Run& run, const std::string& what) const {
    if (run.wrong.empty())
      run.wrong = "command " + std::to_string(at_ + 1) + " (" + commands_[at_].who + " " +
                  commands_[at_].text + "): " + what;
  }

  /// Returns everything the daemon knows except generations and times.
  std::string state() {
    const ctl::System system = stage_.look_in_time();
    std::string text = "connections " + std::to_string(system.daemon.connections) + ", windows " +
                       std::to_string(system.daemon.windows_used) + "\n";
    if (loses_store_) return text + state_in_any_order(system);
    const auto name_of = [&](std::uint32_t pid) { return std::string{name_of_process(pid)}; };
    for (const auto& [index, process] : system.processes) {
      text += "process " + std::to_string(index) + " " + name_of(process.facts.pid) +
              (process.facts.state == ctl::wire::ProcessState::dead ? " dead" : "") +
              " executors " + std::to_string(process.facts.wait_sets) + " windows";
      for (std::uint32_t w = 0; w < process.facts.window_count; ++w)
        text += " " + std::to_string(process.facts.window[w].base);
      text += "\n";
    }
    for (const auto& [index, topic] : system.topics) {
      text += "topic " + std::to_string(index) + " " + topic.name + "\n";
      for (const auto* endpoints : {&topic.publishers, &topic.subscriptions}) {
        for (const ctl::Endpoint& endpoint : *endpoints)
          text += std::string(endpoint.is_publisher() ? "  publisher " : "  subscription ") +
                  std::to_string(endpoint.facts.index) + " of " +
                  std::to_string(endpoint.facts.client) + " at " +
                  std::to_string(endpoint.facts.extent) + " slots " +
                  std::to_string(endpoint.facts.slot_count) + " executor " +
                  std::to_string(endpoint.facts.wait_set) + "\n";
      }
    }
    return text;
  }

  char name_of_process(std::uint32_t pid) const {
    for (const auto& [who, remaining_peer] : remaining_peers_) {
      if (static_cast<std::uint32_t>(remaining_peer->pid()) == pid) return who;
    }
    return victim_ != nullptr && static_cast<std::uint32_t>(victim_->pid()) == pid ? 'V' : '?';
  }

  // The order in which processes reach a new daemon, and the base of its arena, differ each time.
  std::string state_in_any_order(const ctl::System& system) const {
    std::multiset<std::string> lines;
    std::map<std::uint64_t, char> names;
    for (const auto& [index, process] : system.processes) {
      const char name = names[index] = name_of_process(process.facts.pid);
      const bool dead = process.facts.state == ctl::wire::ProcessState::dead;
      lines.insert(std::string("process ") + name + (dead ? " dead" : "") + " executors " +
                   std::to_string(process.facts.wait_sets) + " windows " +
                   std::to_string(process.facts.window_count));
    }
    for (const auto& [index, topic] : system.topics) {
      for (const auto* endpoints : {&topic.publishers, &topic.subscriptions}) {
        for (const ctl::Endpoint& endpoint : *endpoints)
          lines.insert("topic " + topic.name +
                       (endpoint.is_publisher() ? " publisher of " : " subscription of ") +
                       names[endpoint.facts.client] + " slots " +
                       std::to_string(endpoint.facts.slot_count));
      }
    }
    std::string text;
    for (const std::string& line : lines) text += line + "\n";
    return text;
  }

  /// The last errands are done when two looks some time apart see the same.
  std::string state_at_rest() {
    std::string before, now;
    (void)test::eventually([&] {
      before = std::exchange(now, state());
      ::usleep(100'000);
      return before == now;
    });
    return now;
  }

  void await_nothing_left(Run& run) {
    if (baseline_.empty()) return;
    std::string now;
    const auto is_as_before = [&] { return (now = state()) == baseline_; };
    if (!test::eventually(is_as_before)) {
      run.wrong = "something stays behind; before:\n" + baseline_ + "now:\n" + now;
      return;
    }
    if (daemon_dies_) return;  // the next daemon has its own descriptors
    std::size_t descriptors = 0;
    if (!test::eventually(
            [&] { return (descriptors = stage_.daemon().descriptor_count()) == descriptors_; }))
      run.wrong = "the daemon has " + std::to_string(descriptors) + " descriptors, before " +
                  std::to_string(descriptors_);
  }

  // --- comparisons

  std::string compare_answers(const Run& run) const;
  std::string differs(std::size_t i, const std::string& answer) const;

  std::string compare(const Run& run) const;

  std::string judge(const Run& run, std::uint64_t subscription, std::uint64_t publisher) const;
  static std::uint64_t number_in(const std::map<std::uint64_t, std::uint64_t>& numbers,
                                 std::uint64_t publisher) {
    const auto found = numbers.find(publisher);
    return found == numbers.end() ? 0 : found->second;
  }
  static Run::Names names(const Run& run, std::uint64_t subscription, std::uint64_t publisher) {
    const auto of = run.got.find(subscription);
    if (of == run.got.end()) return {};
    const auto from = of->second.find(publisher);
    return from == of->second.end() ? Run::Names() : from->second;
  }

  SweepStage& stage_;
  std::vector<Command> commands_;
  bool loses_store_;
  std::set<char> stopped_;
  std::map<char, std::vector<std::uint64_t>> windows_before_;
  ControlPage control_;
  std::map<std::uint64_t, Publisher> publishers_;
  std::vector<std::unique_ptr<ControlPage>> pages_;
  std::map<char, std::unique_ptr<SweepProcess>> remaining_peers_;
  std::unique_ptr<SweepProcess> victim_;
  std::size_t at_ = 0;
  bool left_something_ = false, revoked_ = false;
  std::optional<Step> from_;
  std::optional<std::pair<std::uint64_t, std::uint64_t>> daemon_deadly_;  // counted from a loss
  Run reference_;
  std::string baseline_;
  std::size_t descriptors_ = 0;
  bool daemon_dies_ = false;
  std::uint64_t points_ = 0, daemon_points_ = 0;
};

}  // namespace agnocast::sweep

#include <tests/recovery/sweep_comparison.hpp>  // bodies
