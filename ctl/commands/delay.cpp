// SPDX-License-Identifier: Apache-2.0
//
// topic delay: the age of messages on arrival, by the stamp in their header.

#include <agnocast/generic.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/message_options.hpp>
#include <ctl/commands/live.hpp>
#include <ctl/messages/message_value.hpp>
#include <ctl/snapshot/select.hpp>

#include <time.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <deque>
#include <utility>

namespace agnocast::ctl {
namespace {

class Delays {
 public:
  explicit Delays(std::size_t window) : window_(window) {}

  void add(double delay_s) {
    delays_.push_back(delay_s);
    if (delays_.size() > window_) delays_.pop_front();
    is_new_ = true;
  }
  /// Prints nothing before the first message.
  void print(Console& console, Json json) {
    if (delays_.empty()) return;
    if (!std::exchange(is_new_, false)) {
      if (json == Json::no) console.line("no new messages");
      return;
    }
    const auto count = static_cast<double>(delays_.size());
    double sum = 0, squares = 0;
    for (const double delay : delays_) sum += delay;
    const double average = sum / count;
    for (const double delay : delays_) squares += (delay - average) * (delay - average);
    const double deviation = std::sqrt(squares / count);
    const auto [least, most] = std::minmax_element(delays_.begin(), delays_.end());
    if (json != Json::no)
      return console.object({{"schema", "agnocast.topic-delay/1"},
                             {"average_s", average},
                             {"min_s", *least},
                             {"max_s", *most},
                             {"standard_deviation_s", deviation},
                             {"window_messages", delays_.size()}},
                            json);
    char text[200];
    std::snprintf(text, sizeof text,
                  "average delay: %.3f\n\tmin: %.3fs max: %.3fs std dev: %.5fs window: %zu",
                  average, *least, *most, deviation, delays_.size());
    console.line(text);
  }

 private:
  const std::size_t window_;
  std::deque<double> delays_;
  bool is_new_ = false;
};

/// Waits until the topic has an endpoint; returns nothing if a signal comes first.
Outcome<std::optional<TopicNow>> wait_for_topic(const Arguments& arguments, Live& live) {
  for (bool first = true;; first = false) {
    auto now = topic_now(arguments);
    if (now) return std::optional(std::move(*now));
    if (now.error().status != Status::no_such_thing) return tl::unexpected(now.error());
    if (first)
      note("topic " + escaped(fully_qualified(arguments.subject(0))) +
           " does not exist yet; waiting for it");
    if (!live.run_until(Live::Clock::now() + std::chrono::milliseconds(100)))
      return std::optional<TopicNow>();
  }
}

}  // namespace

Outcome<void> show_delay(const Arguments& arguments, Console& console) {
  auto live = Live::enter(arguments);
  if (!live) return tl::unexpected(live.error());
  const auto now = wait_for_topic(arguments, **live);
  if (!now) return tl::unexpected(now.error());
  if (!*now) return {};
  const auto type = try_find_message_type((*now)->type);
  if (!type) return problem_of(type.error(), escaped((*now)->type));
  const std::string topic = fully_qualified(arguments.subject(0));
  const auto seconds = Path::parse("header.stamp.sec", type->members());
  const auto rest = Path::parse("header.stamp.nanosec", type->members());
  if (!seconds || !rest)
    return problem(Status::failed, escaped(topic), (*now)->type + " has no header.stamp",
                   "agnocast-ctl topic echo -i " + escaped(topic));

  Delays delays(arguments.whole(options::window));
  const auto add = [&](const GenericMessage& message) {
    timespec clock{};
    ::clock_gettime(CLOCK_REALTIME, &clock);
    const Value value = Value::of(*message.members(), message.get());
    const Scalar stamp_s = seconds->in(value)->scalar(), stamp_ns = rest->in(value)->scalar();
    delays.add(static_cast<double>(clock.tv_sec - std::get<std::int64_t>(stamp_s)) +
               (static_cast<double>(clock.tv_nsec) -
                static_cast<double>(std::get<std::uint64_t>(stamp_ns))) *
                   1e-9);
  };
  const ChosenQos chosen = qos_of(arguments, "sensor_data");
  const auto subscription =
      try_create_generic_subscription((*live)->node(), topic, *type, chosen.qos, add);
  if (!subscription) return problem_of(subscription.error(), escaped(topic));
  constexpr auto period = std::chrono::seconds(1);
  for (auto due = Live::Clock::now() + period; (*live)->run_until(due); due += period) {
    delays.print(console, arguments.json == Json::pretty ? Json::compact : arguments.json);
    if (!write_out()) break;
  }
  return {};
}

}  // namespace agnocast::ctl
