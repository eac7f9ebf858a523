// SPDX-License-Identifier: Apache-2.0
//
// Live: what the commands that take part share. They are nodes of their own in the system they look
// at: known to the daemon, seen by everybody, and gone when they end.
//
// One thread does everything: it sleeps for callbacks and signals at once, so SIGINT and SIGTERM end
// it between two messages, and its endpoints are put away in order.
#pragma once

#include <agnocast/agnocast.hpp>
#include <base/unique_fd.hpp>
#include <ctl/cli/arguments.hpp>
#include <ctl/snapshot/system.hpp>

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// A failure of the library, with the exit status that fits it.
tl::unexpected<Problem> problem_of(const Failure& failure, const std::string& what);

class Live {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr Clock::time_point for_ever = Clock::time_point::max();

  /// Before anything of the library is used: chooses its socket and domain, and blocks the signals.
  /// `node_name`: empty for a hidden one.
  static Outcome<std::unique_ptr<Live>> enter(const Arguments& arguments,
                                              const std::string& node_name = {});

  agnocast::Node& node() { return *node_; }
  /// Runs callbacks until then, or until one has called stop(); false if a signal has come.
  bool run_until(Clock::time_point deadline);
  void stop() { is_stopped_ = true; }

 private:
  Live() = default;
  std::optional<agnocast::Node> node_;
  std::optional<SingleThreadedExecutor> executor_;
  UniqueFd signals_;
  bool is_stopped_ = false;
};

/// After a message is printed: writes it out. False when nobody reads any more; then standard output
/// is forgotten, because that is no failure of ours.
bool write_out();

/// As the options say; `adapted`: without one, what all those publishers offer, as ros2 chooses it.
struct ChosenQos {
  QoS qos;
  std::string note;  // about publishers that offer different things
};
ChosenQos qos_of(const Arguments& arguments, const char* default_profile,
                 const std::vector<Endpoint>* adapted = nullptr);

/// What is to be sent: VALUES (the third subject), --stdin or --yaml-file; without them a default message.
/// Problems: wrong_usage (two of them), failed.
Outcome<std::string> values_of(const Arguments& arguments);
/// CLOCK_REALTIME.
std::int64_t wall_time_ns();

/// The topic now, or nothing.
struct TopicNow {
  std::string type;
  std::uint64_t layout_hash = 0;
  std::vector<Endpoint> publishers;
};
/// Problems of looking, and no_such_thing.
Outcome<TopicNow> topic_now(const Arguments& arguments);

void note(const std::string& text);  // a line on stderr that is no error

}  // namespace agnocast::ctl
