// SPDX-License-Identifier: Apache-2.0
//
// topic echo: a subscription that prints its messages.

#include <agnocast/generic.hpp>
#include <agnocast/relay.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/message_options.hpp>
#include <ctl/commands/live.hpp>
#include <ctl/messages/filter.hpp>
#include <ctl/messages/message_text.hpp>
#include <ctl/snapshot/select.hpp>

#include <time.h>

#include <optional>
#include <utility>

namespace agnocast::ctl {
namespace {

namespace o = options;

struct EchoOptions {
  TextOptions text;
  bool csv = false, raw = false, with_info = false;
  Json json = Json::no;
  std::uint64_t count = 0;  // 0: for ever
  std::optional<double> timeout_s;
};

EchoOptions read(const Arguments& arguments) {
  EchoOptions options;
  options.csv = arguments.has(o::csv);
  options.raw = arguments.has(o::raw);
  options.with_info = arguments.has(o::message_info);
  options.json = arguments.json;
  // One line a message, unless the user asks for --json=pretty.
  if (options.json == Json::pretty && arguments.text(o::json_form) != "pretty")
    options.json = Json::compact;
  options.text.no_arrays = arguments.has(o::no_arr);
  options.text.no_strings = arguments.has(o::no_str);
  const bool is_whole = options.json != Json::no && !arguments.has(o::truncate_length);
  if (!arguments.has(o::full_length) && !is_whole)
    options.text.truncate_length = arguments.whole(o::truncate_length);
  options.count = arguments.has(o::once_echo) ? 1 : arguments.whole(o::message_count);
  if (arguments.has(o::timeout)) options.timeout_s = arguments.real(o::timeout);
  return options;
}

class Printer {
 public:
  Printer(const EchoOptions& options, std::string topic, std::string type, Console& console)
      : options_(options), topic_(std::move(topic)), type_(std::move(type)), console_(console) {}
  std::optional<Path> field;
  std::optional<Filter> filter;

  /// Returns false if the message is filtered out.
  bool print(const GenericMessage& message) {
    if (options_.raw) {
      print_raw(message);
      return true;
    }
    // Only memory of the publisher is printed: anything else may belong to another user.
    const auto copy = try_copy_checked(message);
    if (!copy) {
      note("message " + std::to_string(message.info().sequence) + " of publisher " +
           std::to_string(message.info().publisher) +
           " refers to memory outside its publisher's heap and is not shown");
      return false;
    }
    const Value whole = Value::of(*message.members(), copy->get());
    if (filter && !filter->accepts(whole)) return false;
    const std::optional<Value> value = field ? field->in(whole) : whole;
    if (!value) return false;  // an element that this message does not have
    if (options_.json != Json::no) {
      Object object = object_of(message);
      object[field ? "field" : "message"] = json_of(*value, options_.text);
      console_.object(object, options_.json);
    } else if (options_.csv) {
      console_.line((options_.with_info ? csv_info(message) : "") + csv_of(*value, options_.text));
    } else {
      if (options_.with_info) print_info(message);
      const std::string text = value->shape().is_scalar()
                                   ? bare_text_of(*value, options_.text) + '\n'
                                   : yaml_of(*value, options_.text);
      console_.line(text + "---");
    }
    return true;
  }

 private:
  static std::uint64_t now_ns() {
    timespec now{};
    ::clock_gettime(CLOCK_REALTIME, &now);
    return static_cast<std::uint64_t>(now.tv_sec) * 1'000'000'000 +
           static_cast<std::uint64_t>(now.tv_nsec);
  }
  Object object_of(const GenericMessage& message) {
    return {{"schema", "agnocast.topic-echo/1"},
            {"topic", topic_},
            {"type", type_},
            {"publisher_generation", message.info().publisher},
            {"publication_sequence_number", message.info().sequence},
            {"reception_sequence_number", ++received_},
            {"source_timestamp_ns", message.info().source_timestamp()},
            {"received_timestamp_ns", now_ns()}};
  }
  void print_info(const GenericMessage& message) {
    console_.line("publication_sequence_number: " + std::to_string(message.info().sequence));
    console_.line("received_timestamp: " + std::to_string(now_ns()));
    console_.line("reception_sequence_number: " + std::to_string(++received_));
    console_.line("source_timestamp: " + std::to_string(message.info().source_timestamp()));
    console_.line("---");
  }
  std::string csv_info(const GenericMessage& message) {
    return std::to_string(message.info().source_timestamp()) + ',' + std::to_string(now_ns()) +
           ',' + std::to_string(message.info().sequence) + ',' + std::to_string(++received_) + ',';
  }
  void print_raw(const GenericMessage& message) {
    const std::string text =
        hexadecimal_bytes(message.get(), message.info().object_bytes, options_.text);
    if (options_.json != Json::no) {
      Object object = object_of(message);
      object["raw"] = text;
      return console_.object(object, options_.json);
    }
    if (options_.with_info) print_info(message);
    console_.line(text + "---");
  }

  const EchoOptions& options_;
  const std::string topic_, type_;
  Console& console_;
  std::uint64_t received_ = 0;
};

/// The type to subscribe with.
struct Target {
  std::string type;
  std::uint64_t layout_hash = 0;
  std::optional<IntrospectedType> known;  // not for --raw
};

Outcome<Target> target_of(const Arguments& arguments, const Outcome<TopicNow>& now, bool raw) {
  Target target;
  target.type = arguments.subject(1);
  if (target.type.empty()) {
    if (!now) return tl::unexpected(now.error());
    target.type = now->type;
  }
  if (raw && now) {
    target.layout_hash = now->layout_hash;
    return target;
  }
  const auto found = try_find_message_type(target.type);
  if (!found) return problem_of(found.error(), escaped(target.type));
  const auto type = found->message_type();
  if (!type) return problem_of(type.error(), escaped(target.type));
  target.type = type->name();
  target.layout_hash = type->layout_hash();
  if (!raw) target.known = *found;
  return target;
}

const char* name_of(QosPolicyKind policy) noexcept {
  switch (policy) {
    case QosPolicyKind::durability:
      return "durability";
    case QosPolicyKind::deadline:
      return "deadline";
    case QosPolicyKind::liveliness:
      return "liveliness";
    case QosPolicyKind::liveliness_lease_duration:
      return "liveliness lease";
    case QosPolicyKind::reliability:
    case QosPolicyKind::invalid:
      break;
  }
  return "reliability";
}

}  // namespace

Outcome<void> echo_topic(const Arguments& arguments, Console& console) {
  const EchoOptions options = read(arguments);
  if (options.raw && (options.csv || arguments.has(o::field) || arguments.has(o::filter)))
    return problem(Status::wrong_usage, "--raw",
                   "cannot be combined with --csv, --field and --filter",
                   "agnocast-ctl topic echo --help");
  const Outcome<TopicNow> now = topic_now(arguments);
  // Echo can wait for a topic that does not exist yet, if its type is given.
  if (!now && now.error().status != Status::no_such_thing) return tl::unexpected(now.error());
  auto live = Live::enter(arguments);
  if (!live) return tl::unexpected(live.error());
  const auto target = target_of(arguments, now, options.raw);
  if (!target) return tl::unexpected(target.error());
  const std::string topic = fully_qualified(arguments.subject(0));
  Printer printer(options, topic, target->type, console);
  if (arguments.has(o::field)) {
    auto path = Path::parse(arguments.text(o::field), target->known->members());
    if (!path) return tl::unexpected(path.error());
    printer.field = std::move(*path);
  }
  if (arguments.has(o::filter)) {
    auto filter = Filter::parse(arguments.text(o::filter), target->known->members());
    if (!filter) return tl::unexpected(filter.error());
    printer.filter = std::move(*filter);
  }

  std::uint64_t printed = 0;
  const auto print = [&](const GenericMessage& message) {
    if (options.count != 0 && printed == options.count) return;
    if (!printer.print(message)) return;
    ++printed;
    if (!write_out() || printed == options.count) (*live)->stop();
  };
  SubscriptionOptions events;
  events.incompatible_qos_callback([](IncompatibleQosInfo& info) {
    note(std::string("a publisher offers less than requested: ") + name_of(info.last_policy_kind));
  });
  const ChosenQos chosen = qos_of(arguments, "sensor_data", now ? &now->publishers : nullptr);
  if (!chosen.note.empty()) note(chosen.note);
  agnocast::Node& node = (*live)->node();
  const auto subscription =
      target->known
          ? try_create_generic_subscription(node, topic, *target->known, chosen.qos, print, events)
          : try_create_generic_subscription(node, topic,
                                            TypeIdentity{target->type, target->layout_hash},
                                            chosen.qos, print, events);
  if (!subscription) return problem_of(subscription.error(), escaped(topic));
  const auto deadline =
      options.timeout_s
          ? Live::Clock::now() + std::chrono::duration_cast<Live::Clock::duration>(
                                     std::chrono::duration<double>(*options.timeout_s))
          : Live::for_ever;
  const bool ended_by_itself = (*live)->run_until(deadline);
  if ((*subscription)->get_lost_count() != 0)
    note(counted((*subscription)->get_lost_count(), "message") +
         " lost: they arrived faster than they could be printed");
  const std::uint64_t wanted = options.count == 0 ? 1 : options.count;
  if (ended_by_itself && options.timeout_s && printed < wanted && std::ferror(stdout) == 0)
    return problem(
        Status::timed_out, escaped(topic),
        counted(printed, "message") + " arrived within " + arguments.text(o::timeout) + " s",
        "agnocast-ctl topic info -v " + escaped(topic));
  return {};
}

}  // namespace agnocast::ctl
