// SPDX-License-Identifier: Apache-2.0
//
// metrics: numbers for Prometheus, in its text format or in OpenMetrics, to stdout or into a file
// for the textfile collector of node_exporter. The file is replaced atomically; it says
// agnocast_up 0 while the daemon does not answer.
//
// Each endpoint's counter is a series of its own, not part of a sum: a sum would fall when an
// endpoint ends, and Prometheus would take that for a reset of the counter.

#include <base/clock.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/waiting.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <ctl/snapshot/overview.hpp>
#include <ctl/snapshot/select.hpp>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <initializer_list>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

namespace agnocast::ctl {
namespace {

using Label = std::pair<std::string_view, std::string>;

/// The labels of one thing with several samples, in the form of the text formats, without braces.
class Labels {
 public:
  Labels(std::initializer_list<Label> labels) {
    for (const Label& label : labels) add(label);
  }
  Labels with(Label label) const {
    Labels all = *this;
    all.add(std::move(label));
    return all;
  }
  const std::vector<Label>& list() const noexcept { return list_; }
  const std::string& text() const noexcept { return text_; }

 private:
  void add(Label label) {
    if (!text_.empty()) text_ += ',';
    text_.append(label.first).append("=\"");
    for (const char c : escaped(label.second)) {
      if (c == '\\' || c == '"') text_ += '\\';
      text_ += c;
    }
    text_ += '"';
    list_.push_back(std::move(label));
  }

  std::vector<Label> list_;
  std::string text_;
};
using SharedLabels = std::shared_ptr<const Labels>;

struct Sample {
  SharedLabels labels;  // null: none
  std::variant<std::uint64_t, double> value;
};
struct Family {
  std::string name;  // without the suffix _total of a counter's samples
  std::string_view type, unit, help;
  std::vector<Sample> samples;
};

class Metrics {
 public:
  /// Begins a family. `unit` is the suffix of the name, or empty.
  void gauge(const std::string& name, std::string_view unit, std::string_view help) {
    families_.push_back({"agnocast_" + name, "gauge", unit, help, {}});
  }
  void counter(const std::string& name, std::string_view unit, std::string_view help) {
    families_.push_back({"agnocast_" + name, "counter", unit, help, {}});
  }
  /// Adds a sample to the family begun last.
  template <class Number>
  void sample(SharedLabels labels, Number value) {
    families_.back().samples.push_back({std::move(labels), value});
  }
  template <class Number>
  void sample(Labels labels, Number value) {
    sample(std::make_shared<const Labels>(std::move(labels)), value);
  }
  template <class Number>
  void sample(Number value) {
    sample(SharedLabels(), value);
  }

  /// Returns the text. Only Prometheus names a family with the suffix of its samples.
  std::string text(bool is_openmetrics) const {
    std::string text;
    for (const Family& family : families_) {
      const std::string sample = family.name + (family.type == "counter" ? "_total" : "");
      const std::string& name = is_openmetrics ? family.name : sample;
      text.append("# HELP ").append(name).append(" ").append(family.help);
      text.append("\n# TYPE ").append(name).append(" ").append(family.type).append("\n");
      if (is_openmetrics && !family.unit.empty())
        text += "# UNIT " + name + ' ' + std::string(family.unit) + '\n';
      for (const auto& [labels, value] : family.samples) {
        text += sample;
        if (labels != nullptr) text.append("{").append(labels->text()).append("}");
        text.append(" ").append(number_of(value)).append("\n");
      }
    }
    return is_openmetrics ? text + "# EOF\n" : text;
  }
  Object object() const {
    Object families = Object::array();
    for (const Family& family : families_) {
      Object samples = Object::array();
      for (const auto& [labels, value] : family.samples) {
        Object names = Object::object();
        if (labels != nullptr)
          for (const auto& [label, of] : labels->list()) names[std::string(label)] = of;
        samples.push_back(
            {{"labels", names}, {"value", std::visit([](auto v) { return Object(v); }, value)}});
      }
      families.push_back({{"name", family.name},
                          {"type", family.type},
                          {"unit", family.unit},
                          {"help", family.help},
                          {"samples", samples}});
    }
    return {{"schema", "agnocast.metrics/1"}, {"families", families}};
  }

 private:
  // Returns a double as JSON writes it: the shortest text that reads back as the same value.
  static std::string number_of(const std::variant<std::uint64_t, double>& value) {
    if (const auto* const count = std::get_if<std::uint64_t>(&value)) return std::to_string(*count);
    return Object(std::get<double>(value)).dump();
  }

  std::vector<Family> families_;
};

void add_daemon(const System& system, Metrics& metrics) {
  const wire::DumpDaemon& daemon = system.daemon;
  const wire::DaemonCounters& counters = daemon.counters;
  metrics.gauge("uptime_seconds", "seconds", "Time since agnocastd started.");
  metrics.sample(static_cast<double>(daemon.uptime_ns) / 1e9);
  metrics.gauge("arena_bytes", "bytes", "Address space for shared heaps.");
  metrics.sample(daemon.arena_bytes);
  metrics.gauge("heap_windows", "", "Heap windows in use.");
  metrics.sample(daemon.windows_used);
  metrics.gauge("kept_descriptors", "", "Descriptors kept for a restart of agnocastd.");
  metrics.sample(daemon.kept_descriptors);
  metrics.gauge("kept_descriptors_limit", "", "Limit of descriptors kept for a restart.");
  metrics.sample(daemon.kept_descriptors_max);
  for (const auto& [name, help, value] :
       {std::tuple("restarts", "Restarts of agnocastd with its state kept.", counters.restarts),
        std::tuple("processes_registered", "Processes that joined.", counters.clients_registered),
        std::tuple("processes_rejoined", "Processes that came back after they lost agnocastd.",
                   counters.clients_rejoined),
        std::tuple("processes_died", "Processes that ended without leaving.",
                   counters.clients_died),
        std::tuple("processes_unmapped", "Processes that left.", counters.clients_unmapped),
        std::tuple("processes_revoked", "Processes whose session was revoked.",
                   counters.clients_revoked),
        std::tuple("intents_rolled_back", "Interrupted operations of dead processes, undone.",
                   counters.intents_rolled_back),
        std::tuple("intents_rolled_forward", "Interrupted operations of dead processes, completed.",
                   counters.intents_rolled_forward),
        std::tuple("intents_corrupt", "Interrupted operations with invalid records.",
                   counters.intents_corrupt),
        std::tuple("requests_refused", "Refused requests; see the log.", counters.requests_refused),
        std::tuple("connections_refused", "Refused connections; see the log.",
                   counters.connections_refused),
        std::tuple("readers_withdrawn", "Times that a publisher stopped serving a subscription.",
                   counters.readers_withdrawn),
        std::tuple("readers_served_again", "Times that a publisher served a subscription again.",
                   counters.readers_served_again),
        std::tuple("readers_mute", "Times that a subscription lost its doorbell.",
                   counters.readers_mute)}) {
    metrics.counter(name, "", help);
    metrics.sample(value);
  }
}

void add_users(const System& system, Metrics& metrics) {
  metrics.gauge("user_in_use", "", "Use of each resource by a user.");
  for (const wire::DumpUser& user : system.users) {
    const Object shares = share_object(user.use);
    for (const auto& [resource, used] : shares.items())
      metrics.sample({{"uid", std::to_string(user.uid)}, {"resource", resource}},
                     used.get<std::uint64_t>());
  }
  metrics.gauge("user_quota", "", "Limit of each resource for a user; no sample: no limit.");
  const Object quotas = share_object(system.daemon.quota);
  for (const auto& [resource, quota] : quotas.items()) {
    if (!quota.is_null()) metrics.sample({{"resource", resource}}, quota.get<std::uint64_t>());
  }
}

void add_processes(const System& system, Metrics& metrics) {
  std::map<wire::ProcessState, std::uint64_t> states{{wire::ProcessState::connected, 0},
                                                     {wire::ProcessState::orphaned, 0},
                                                     {wire::ProcessState::dead, 0},
                                                     {wire::ProcessState::revoked, 0}};
  for (const auto& [index, process] : system.processes) ++states[process.facts.state];
  metrics.gauge("processes", "", "Processes by state; memory of dead ones is still in use.");
  for (const auto& [state, count] : states) {
    const char* const word = state == wire::ProcessState::connected  ? "alive"
                             : state == wire::ProcessState::orphaned ? "orphaned"
                             : state == wire::ProcessState::dead     ? "dead"
                                                                     : "revoked";
    metrics.sample({{"state", word}}, count);
  }
  metrics.gauge("heap_used_bytes", "bytes", "Heap memory in use by a process.");
  for (const auto& [index, process] : system.processes) {
    // Several processes share a pid where the daemon cannot see their PID namespaces.
    metrics.sample({{"client", std::to_string(process.facts.client) + '.' +
                                   std::to_string(process.facts.generation)},
                    {"pid", std::to_string(process.facts.pid)},
                    {"process", process.name}},
                   heap_used(process));
  }
}

void add_topics(const System& system, Metrics& metrics, std::uint64_t now_ns) {
  Overview overview;
  const std::vector<Row> rows = overview.look(system, true, 0, now_ns);
  std::vector<SharedLabels> labels;
  labels.reserve(rows.size());
  for (const Row& row : rows)
    labels.push_back(std::make_shared<const Labels>(
        Labels{{"domain", std::to_string(row.topic->facts.domain)}, {"topic", row.topic->name}}));
  const auto each = [&](const char* name, std::string_view unit, std::string_view help,
                        const auto& value_of) {
    metrics.gauge(name, unit, help);
    for (std::size_t i = 0; i < rows.size(); ++i) metrics.sample(labels[i], value_of(rows[i]));
  };
  each("topic_publishers", "", "Publishers of a topic.",
       [](const Row& row) { return row.publishers; });
  each("topic_subscriptions", "", "Subscriptions of a topic.",
       [](const Row& row) { return row.subscriptions; });
  each("topic_unread_messages", "", "Messages that the slowest reader has not taken.",
       [](const Row& row) { return row.lag; });
  each("topic_held_messages", "", "Messages held by subscriptions.",
       [](const Row& row) { return row.held; });
  each("topic_oldest_hold_seconds", "seconds", "Age of the oldest held message.",
       [](const Row& row) { return static_cast<double>(row.oldest_held_ns) / 1e9; });
  each("topic_trouble", "",
       "1 if an endpoint is refused or not matched, a reader lags, a message is held long, or a "
       "dead publisher has unread messages.",
       [](const Row& row) { return std::uint64_t{row.trouble < Trouble::running}; });
}

SharedLabels labels_of(const System& system, const Topic& topic, const Endpoint& endpoint) {
  const Process* const process = system.process_of(endpoint);
  return std::make_shared<const Labels>(
      Labels{{"domain", std::to_string(topic.facts.domain)},
             {"topic", topic.name},
             {"node", node_name_of(endpoint)},
             {"pid", process == nullptr ? "gone" : std::to_string(process->facts.pid)},
             {"generation", std::to_string(endpoint.facts.generation)}});
}

void add_endpoints(const System& system, Metrics& metrics) {
  std::vector<std::pair<SharedLabels, PublisherCounters>> publishers;
  std::vector<std::pair<SharedLabels, SubscriptionNumbers>> subscriptions;
  for (const auto& [index, topic] : system.topics) {
    for (const Endpoint& publisher : topic.publishers) {
      if (const auto counters = counters_of_publisher(system, topic, publisher))
        publishers.emplace_back(labels_of(system, topic, publisher), *counters);
    }
    for (const Endpoint& subscription : topic.subscriptions) {
      if (const auto numbers = numbers_of_subscription(system, topic, subscription))
        subscriptions.emplace_back(labels_of(system, topic, subscription), *numbers);
    }
  }
  const auto each = [&](const auto& all, const char* name, std::string_view unit,
                        std::string_view help, auto member) {
    metrics.counter(name, unit, help);
    for (const auto& [labels, numbers] : all) metrics.sample(labels, numbers.*member);
  };
  each(publishers, "published_messages", "", "Messages published.", &PublisherCounters::published);
  each(publishers, "published_bytes", "bytes", "Bytes of published messages, containers included.",
       &PublisherCounters::published_bytes);
  each(publishers, "adopted_messages", "",
       "Messages with parts from another heap, which were copied: not zero-copy.",
       &PublisherCounters::adopted_messages);
  each(publishers, "adopted_bytes", "bytes", "Bytes copied for them.",
       &PublisherCounters::adopted_bytes);
  metrics.counter("unpublished_messages", "", "Messages that could not be published, by reason.");
  for (const auto& [labels, numbers] : publishers) {
    for (const auto& [reason, count] :
         {std::pair("no_slot", numbers.refused_no_slot),
          std::pair("would_block", numbers.refused_would_block),
          std::pair("heap_exhausted", numbers.refused_heap_exhausted)})
      metrics.sample(labels->with({"reason", reason}), count);
  }
  each(subscriptions, "lost_messages", "", "Messages overwritten before a subscription took them.",
       &SubscriptionNumbers::lost);
  each(subscriptions, "malformed_messages", "", "Messages that failed a subscription's checks.",
       &SubscriptionNumbers::malformed);
  each(subscriptions, "unreachable_messages", "",
       "Messages not taken because their address is in use in the subscriber.",
       &SubscriptionNumbers::unreachable);
  each(subscriptions, "expired_messages", "",
       "Messages not taken because they were older than their publisher's lifespan.",
       &SubscriptionNumbers::expired);
}

Metrics metrics_of(const System* system) {
  Metrics metrics;
  metrics.gauge("up", "", "1 if agnocastd answered.");
  metrics.sample(std::uint64_t{system != nullptr});
  if (system != nullptr) {
    add_daemon(*system, metrics);
    add_users(*system, metrics);
    add_processes(*system, metrics);
    add_topics(*system, metrics, monotonic_ns());
    add_endpoints(*system, metrics);
  }
  return metrics;
}

bool write_all(int fd, std::string_view text) {
  while (!text.empty()) {
    const ssize_t count = ::write(fd, text.data(), text.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return false;
    text.remove_prefix(static_cast<std::size_t>(count));
  }
  return true;
}

/// Replaces the whole file atomically, for concurrent readers. The temporary file gets an
/// unpredictable name: other users may write to the directory as well.
Outcome<void> write_file(const std::string& path, const std::string& text) {
  std::string made = path + ".XXXXXX";
  const UniqueFd file(::mkostemp(made.data(), O_CLOEXEC));
  const bool is_there = file && write_all(file.get(), text) && ::fchmod(file.get(), 0644) == 0 &&
                        ::rename(made.c_str(), path.c_str()) == 0;
  if (is_there) return {};
  const int error = errno;
  if (file) ::unlink(made.c_str());
  return problem(Status::failed, escaped(path),
                 std::string("it cannot be written: ") + std::strerror(error),
                 error == ENOSPC ? "df" : "choose a directory that this user may write");
}

}  // namespace

Outcome<void> write_metrics(const Arguments& arguments, Console& console) {
  const Waiting waiting;
  const std::string path = arguments.text(options::output);
  const bool goes_on = arguments.has(options::every);
  const bool is_openmetrics = arguments.text(options::metrics_form) == "openmetrics";
  if (arguments.json != Json::no && !path.empty())
    return problem(Status::wrong_usage, "--json",
                   "cannot be combined with --output: files are for Prometheus",
                   "agnocast-ctl metrics --json >FILE");
  if (goes_on && path.empty())
    return problem(Status::wrong_usage, "--every", "there is no file to rewrite",
                   "agnocast-ctl metrics --every 15 --output FILE");
  for (;;) {
    const auto look = look_at(arguments.socket);
    // Only an absent daemon becomes agnocast_up 0; it would misrepresent any other problem.
    if (!look && (path.empty() || look.error().status != Status::not_reachable))
      return tl::unexpected(look.error());
    const Metrics metrics = metrics_of(look ? &look->system : nullptr);
    if (!path.empty()) {
      if (auto written = write_file(path, metrics.text(is_openmetrics)); !written) return written;
    } else if (arguments.json != Json::no) {
      console.object(metrics.object(), arguments.json);
    } else {
      console.text(metrics.text(is_openmetrics));
    }
    if (!goes_on) return look ? Outcome<void>() : tl::unexpected(look.error());
    if (!waiting.sleep_ms(static_cast<int>(arguments.real(options::every) * 1000))) return {};
  }
}

}  // namespace agnocast::ctl
