// SPDX-License-Identifier: Apache-2.0
//
// topic pub: publishes messages from the command line, a file or standard input.

#include <agnocast/generic.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/message_options.hpp>
#include <ctl/commands/live.hpp>
#include <ctl/messages/message_read.hpp>
#include <ctl/messages/message_text.hpp>
#include <ctl/snapshot/select.hpp>

#include <optional>
#include <utility>

namespace agnocast::ctl {
namespace {

namespace o = options;

// Typed messages are shown in full, messages from a file only in part.
constexpr TextOptions shown_part{128, false, false};

using Clock = Live::Clock;

struct Course {
  std::uint64_t times = 0;  // 0: for ever
  Clock::duration period{};
  std::uint64_t print_each = 1;
  std::uint64_t wanted_subscriptions = 0;
  std::optional<double> wait_s;
};

Course course_of(const Arguments& arguments, std::size_t message_count) {
  Course course;
  course.times = arguments.has(o::once_pub) ? 1 : arguments.whole(o::times);
  // A file is sent once, from its first message to its last.
  if (course.times == 0 && arguments.has(o::yaml_file)) course.times = message_count;
  course.period = Live::seconds(1 / arguments.real(o::rate));
  course.print_each = arguments.whole(o::print_each);
  const bool is_bounded = arguments.has(o::once_pub) || arguments.has(o::times);
  course.wanted_subscriptions =
      arguments.has(o::wait_matching) ? arguments.whole(o::wait_matching) : (is_bounded ? 1 : 0);
  if (arguments.has(o::max_wait)) course.wait_s = arguments.real(o::max_wait);
  return course;
}

class Sender {
 public:
  Sender(Live& live, GenericPublisher& publisher, const IntrospectedType& type, Console& console)
      : live_(live), publisher_(publisher), type_(type), console_(console) {}

  /// Returns false after a signal, or if nobody reads standard output.
  Outcome<bool> wait_for_subscriptions(const Course& course) {
    constexpr std::chrono::milliseconds step{20}, say_nothing{100}, remind{1000};
    const auto begin = Clock::now();
    auto next_note = begin + say_nothing;
    while (publisher_.get_subscription_count() < course.wanted_subscriptions) {
      const auto now = Clock::now();
      if (now >= next_note) {
        console_.line("Waiting for at least " + std::to_string(course.wanted_subscriptions) +
                      " matching subscription(s)...");
        if (!write_out()) return false;
        next_note = now + remind;
      }
      if (course.wait_s && now - begin >= Live::seconds(*course.wait_s))
        return problem(Status::timed_out, publisher_.get_topic_name(),
                       counted(publisher_.get_subscription_count(), "matching subscription") +
                           " of " + std::to_string(course.wanted_subscriptions) +
                           " matched in time",
                       "agnocast-ctl topic info -v " + escaped(publisher_.get_topic_name()));
      if (!live_.run_until(now + step)) return false;
    }
    return true;
  }

  Outcome<bool> send_all(const std::vector<ReadMessage>& messages, const Course& course) {
    if (course.print_each != 0) console_.line("publisher: beginning loop");
    auto due = Clock::now();
    for (std::uint64_t count = 1; course.times == 0 || count <= course.times; ++count) {
      const ReadMessage& message = messages[(count - 1) % messages.size()];
      if (auto sent = send(message); !sent || !*sent) return sent;
      if (course.print_each != 0 && count % course.print_each == 0) {
        console_.line("publishing #" + std::to_string(count) + ": " +
                      flow_yaml_of(Value::of(type_.members(), message.message.get()), shown_part) +
                      '\n');
        if (!write_out()) return false;
      }
      if (count == course.times) break;
      due += course.period;
      if (!live_.run_until(due)) return false;
    }
    return true;
  }

 private:
  PublishResult publish_one(const ReadMessage& message) {
    GenericLoan loan = publisher_.borrow_loaned_message();
    type_.assign(message.message.get(), loan.get());
    return publisher_.publish(std::move(loan));
  }
  Outcome<bool> send(const ReadMessage& message) {
    message.set_times(wall_time_ns());
    for (;;) {
      const PublishResult result = publish_one(message);
      if (result) return true;
      if (result.code != Errc::would_block && result.code != Errc::no_slot)
        return problem_of({result.code, 0, "", 0}, publisher_.get_topic_name());
      // The readers have not released enough messages yet.
      if (!live_.run_until(Clock::now() + std::chrono::milliseconds(1))) return false;
    }
  }

  Live& live_;
  GenericPublisher& publisher_;
  const IntrospectedType& type_;
  Console& console_;
};

}  // namespace

Outcome<void> pub_topic(const Arguments& arguments, Console& console) {
  if (arguments.has(o::once_pub) && arguments.has(o::times))
    return problem(Status::wrong_usage, "--once", "cannot be combined with --times",
                   "agnocast-ctl topic pub --help");
  const auto type = try_find_message_type(arguments.subject(1));
  if (!type) return problem_of(type.error(), escaped(arguments.subject(1)));
  const auto text = values_of(arguments);
  if (!text) return tl::unexpected(text.error());
  const auto messages = read_messages(*text, *type);
  if (!messages) return tl::unexpected(messages.error());
  const Course course = course_of(arguments, messages->size());
  if (course.wait_s && course.wanted_subscriptions == 0)
    return problem(Status::wrong_usage, "--max-wait-time-secs",
                   "needs --once, --times or --wait-matching-subscriptions",
                   "agnocast-ctl topic pub --help");
  auto live = Live::enter(arguments, arguments.text(o::node_name));
  if (!live) return tl::unexpected(live.error());
  const std::string topic = fully_qualified(arguments.subject(0));
  const auto publisher =
      try_create_generic_publisher((*live)->node(), topic, *type, qos_of(arguments, "default").qos);
  if (!publisher) return problem_of(publisher.error(), escaped(topic));
  Sender sender(**live, **publisher, *type, console);
  auto goes_on = sender.wait_for_subscriptions(course);
  if (goes_on && *goes_on) goes_on = sender.send_all(*messages, course);
  if (!goes_on) return tl::unexpected(goes_on.error());
  if (*goes_on)
    (void)(*live)->run_until(Clock::now() + Live::seconds(arguments.real(o::keep_alive)));
  return {};
}

}  // namespace agnocast::ctl
