// SPDX-License-Identifier: Apache-2.0
//
// Live: the common part of the commands that publish or subscribe. Such a command is a node of its
// own in the system: the daemon knows it, all others see it, and it is gone when it ends.
//
// One thread does everything: it waits for callbacks and signals together, so SIGINT and SIGTERM
// end it between two messages, and its endpoints are closed in order.
#pragma once

#include <agnocast/agnocast.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <ctl/cli/arguments.hpp>
#include <ctl/snapshot/system.hpp>

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// Returns a failure of the library as a problem with the matching exit status.
tl::unexpected<Problem> problem_of(const Failure& failure, const std::string& what);

class Live {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr Clock::time_point for_ever = Clock::time_point::max();
  static Clock::duration seconds(double count) {
    return std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(count));
  }

  /// Call before the first use of the library: chooses its socket and domain, and blocks the
  /// signals. An empty `node_name` creates a hidden node.
  static Outcome<std::unique_ptr<Live>> enter(const Arguments& arguments,
                                              const std::string& node_name = {});

  agnocast::Node& node() { return *node_; }
  /// Runs callbacks until the deadline or a call of stop(); returns false if a signal has come.
  bool run_until(Clock::time_point deadline);
  void stop() { is_stopped_ = true; }
  bool is_ended_by_signal() const;

 private:
  Live() = default;
  std::optional<agnocast::Node> node_;
  std::optional<SingleThreadedExecutor> executor_;
  UniqueFd signals_;
  bool is_stopped_ = false;
};

/// Flushes standard output after a message. Returns false if nobody reads it any more: standard
/// output is then redirected to /dev/null, because that is not an error.
bool write_out();

/// Returns the QoS of the options; without any, what all of `adapted` offer, as ros2 chooses it.
struct ChosenQos {
  QoS qos;
  std::string note;  // about publishers with different QoS
};
ChosenQos qos_of(const Arguments& arguments, const char* default_profile,
                 const std::vector<Endpoint>* adapted = nullptr);

/// Returns the YAML of VALUES (the third subject), --stdin or --yaml-file; "{}" without them.
/// Problems: wrong_usage (two of them), failed.
Outcome<std::string> values_of(const Arguments& arguments);
/// CLOCK_REALTIME.
std::int64_t wall_time_ns();

/// The type and the active publishers of a topic.
struct TopicNow {
  std::string type;
  std::uint64_t layout_hash = 0;
  std::vector<Endpoint> publishers;
};
/// Problems: those of look_at(), and no_such_thing.
Outcome<TopicNow> topic_now(const Arguments& arguments);

void note(const std::string& text);  // prints a line on stderr, not an error

}  // namespace agnocast::ctl
