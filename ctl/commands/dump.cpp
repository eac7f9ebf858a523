// SPDX-License-Identifier: Apache-2.0
//
// dump: the answers of the other commands as one JSON object; with --watch one more object
// whenever one of them has changed.

#include <base/clock.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/waiting.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/watch.hpp>

namespace agnocast::ctl {
namespace {

// As often as a person can read a screen.
constexpr int interval_ms = 500;

Object object_of(const System& system, const Arguments& arguments) {
  Object object{{"schema", "agnocast.dump/1"}};
  object["status"] = status_object(system, arguments.socket);
  for (const char* const part : {"topics", "processes", "windows", "messages", "refusals"})
    object[part] = Object::array();
  const std::uint64_t now_ns = monotonic_ns();
  const auto append = [&](const char* part, Object list) {
    for (Object& item : list) object[part].push_back(std::move(item));
  };
  for (const Topic* const topic : topics_of(system, arguments)) {
    object["topics"].push_back(topic_object(system, *topic));
    append("messages", messages_object(system, *topic, now_ns));
  }
  for (const Process* const process : processes_of(system, arguments)) {
    object["processes"].push_back(process_object(system, *process));
    append("windows", windows_object(system, *process));
  }
  for (const wire::DumpRefusal& refusal : system.refusals)
    object["refusals"].push_back(refusal_object(refusal));
  object["threads"] = threads_object(system, arguments);
  return object;
}

/// Removes the values that change with time alone.
Object without_time(Object object) {
  object["status"]["daemon"].erase("uptime_ns");
  for (const char* const part : {"processes", "messages", "refusals"}) {
    for (Object& item : object[part]) item.erase("age_ns");
  }
  for (Object& thread : object["threads"]) thread.erase("cpu_time_ns");
  return object;
}

}  // namespace

Outcome<void> dump_all(const Arguments& arguments, Console& console) {
  const Waiting waiting;
  auto watch = Watch::begin(arguments.socket, {.threads = true});
  if (!watch) return tl::unexpected(watch.error());
  const Json form = arguments.json == Json::pretty ? Json::pretty : Json::compact;
  Object last;
  do {
    if (auto renewed = watch->renew(); !renewed) return renewed;
    const Object now = object_of(watch->system(), arguments);
    if (arguments.has(options::watch)) {
      Object lasting = without_time(now);
      if (lasting == last) continue;
      last = std::move(lasting);
    }
    console.object(now, form);
    console.flush();
  } while (arguments.has(options::watch) && waiting.sleep_ms(interval_ms));
  return {};
}

}  // namespace agnocast::ctl
