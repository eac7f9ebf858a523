// SPDX-License-Identifier: Apache-2.0
//
// Graph: reads the daemon's graph table, and sleeps until the daemon says that it has changed. One
// thread may wait while another one looks: they share only the table, which HostGraph hands out.

#include <agnocast/graph.hpp>

#include <base/descriptors/kept_fd.hpp>
#include <client/connection/registration.hpp>
#include <client/process/forked_child.hpp>
#include <client/session/context.hpp>
#include <client/session/host_graph.hpp>
#include <region/graph_entry.hpp>

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <new>
#include <tuple>
#include <utility>

namespace agnocast {
namespace {

namespace wire = abi::wire;
using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

// Combines changes, at least: nodes come with a dozen endpoints each.
constexpr milliseconds gather_time{10};
// Longer than any useful wait, and short enough to be added to a time.
constexpr milliseconds timeout_max = std::chrono::hours(24 * 365);
// A restarted daemon is back within some ten milliseconds.
constexpr milliseconds reconnect_interval{50};

std::string text_of(const wire::Name& name) {
  return {name.text, ::strnlen(name.text, sizeof name.text)};
}

QoS qos_of(const abi::QosWords& words) noexcept {
  const abi::Qos from = abi::unpack_qos(words);
  const auto time = [](std::uint64_t ns) {
    return std::chrono::nanoseconds(static_cast<std::int64_t>(std::min(ns, abi::qos_time_max_ns)));
  };
  QoS qos(from.depth);
  if (from.keep_all) qos.keep_all(from.depth);
  from.reliable ? qos.reliable() : qos.best_effort();
  if (from.transient_local) qos.transient_local();
  if (from.manual_liveliness) qos.liveliness(Liveliness::manual_by_topic);
  return qos.deadline(time(from.deadline_ns))
      .lifespan(time(from.lifespan_ns))
      .liveliness_lease_duration(time(from.lease_ns));
}

EndpointInfo info_of(const region::GraphFacts& facts) {
  EndpointInfo info;
  info.kind =
      facts.kind == wire::Kind::publisher ? EndpointKind::publisher : EndpointKind::subscription;
  info.domain = facts.domain;
  info.topic = text_of(facts.topic);
  info.type = text_of(facts.type);
  info.layout_hash = facts.layout_hash;
  const std::string node = text_of(facts.node);
  const std::size_t slash = node.rfind('/');
  info.node_name = slash == std::string::npos ? node : node.substr(slash + 1);
  info.node_namespace = slash == std::string::npos || slash == 0 ? "/" : node.substr(0, slash);
  info.qos = qos_of(facts.qos);
  info.generation = facts.generation;
  info.pid = static_cast<std::uint32_t>(facts.pid);
  info.uid = static_cast<std::uint32_t>(facts.uid);
  info.client = facts.client;
  info.is_own = facts.client == Registration::last_client();
  info.process_name = text_of(facts.process);
  return info;
}

GraphSnapshot read(const GraphTable& table) {
  GraphSnapshot snapshot;
  snapshot.incarnation = table.incarnation();
  snapshot.missing = table.missing_count();
  const std::uint64_t count = table.entry_count();
  for (std::uint64_t i = 0; i < count; ++i) {
    if (const auto facts = region::load_entry(table.entry(i)))
      snapshot.endpoints.push_back(info_of(*facts));
  }
  const auto place = [](const EndpointInfo& endpoint) {
    return std::tie(endpoint.topic, endpoint.domain, endpoint.kind, endpoint.generation);
  };
  std::sort(snapshot.endpoints.begin(), snapshot.endpoints.end(),
            [&](const EndpointInfo& a, const EndpointInfo& b) { return place(a) < place(b); });
  return snapshot;
}

/// What somebody knows of each entry: the generation of its endpoint, 0: none.
using Known = std::vector<std::uint64_t>;

GraphChanges compare(const GraphTable& table, Known& known) {
  GraphChanges changes;
  changes.incarnation = table.incarnation();
  changes.missing = table.missing_count();
  known.resize(std::max<std::size_t>(known.size(), table.entry_count()));
  for (std::size_t i = 0; i < known.size(); ++i) {
    const abi::GraphEntry& entry = table.entry(i);
    if (entry.word.load(std::memory_order_relaxed) == known[i]) continue;
    if (known[i] != 0) changes.removed.push_back(known[i]);
    known[i] = 0;
    const auto facts = region::load_entry(entry);
    if (!facts) continue;
    changes.added.push_back(info_of(*facts));
    known[i] = facts->generation;
  }
  return changes;
}

}  // namespace

class Graph::State {
 public:
  State() : event_(keep(UniqueFd(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)))) {
    if (!event_) throw std::bad_alloc();
    if (!is_forked_child()) graph_.add(event_.get());
  }
  ~State() {
    if (!is_forked_child()) graph_.remove(event_.get());
  }
  State(const State&) = delete;
  State& operator=(const State&) = delete;

  Result<std::optional<GraphSnapshot>> wait(milliseconds timeout) {
    auto table = wait_for_table(timeout);
    if (!table) return tl::unexpected<Failure>(table.error());
    if (*table == nullptr) return std::optional<GraphSnapshot>();
    const Clock::time_point begin = Clock::now();
    const std::uint64_t changes = (*table)->changes();
    GraphSnapshot snapshot = read(**table);
    see(std::move(*table), changes);
    // Reading takes a fifth of the time at most, however often something changes.
    const Clock::time_point end = Clock::now();
    gathered_ = end + std::max<Clock::duration>(gather_time, 4 * (end - begin));
    return std::optional(std::move(snapshot));
  }
  Result<bool> wait_for_change(milliseconds timeout) {
    auto table = wait_for_table(timeout);
    if (!table) return tl::unexpected<Failure>(table.error());
    if (*table == nullptr) return false;
    const std::uint64_t changes = (*table)->changes();
    see(std::move(*table), changes);
    // Looking takes a fifth of the time at most, too.
    const Clock::duration look = look_time_.load(std::memory_order_relaxed);
    gathered_ = Clock::now() + std::max<Clock::duration>(gather_time, 4 * look);
    return true;
  }
  std::optional<GraphChanges> look() {
    if (is_forked_child()) return std::nullopt;
    auto table = graph_.table();
    if (table == nullptr) return std::nullopt;
    const std::uint64_t now = table->changes();
    const bool is_reset = looked_at_ != table;
    if (!is_reset && now == looked_changes_) return std::nullopt;
    if (is_reset) known_.clear();
    const Clock::time_point begin = Clock::now();
    try {
      GraphChanges changes = compare(*table, known_);
      changes.is_reset = is_reset;
      look_time_.store(Clock::now() - begin, std::memory_order_relaxed);
      looked_at_ = std::move(table);
      looked_changes_ = now;
      return changes;
    } catch (const std::bad_alloc&) {
      start_over();  // known_ has what nobody was given
      throw;
    }
  }
  void start_over() noexcept {
    known_.clear();
    looked_at_.reset();
  }
  void interrupt() noexcept {
    if (is_forked_child()) return;
    is_interrupted_.store(true, std::memory_order_release);
    const int before = errno;
    const std::uint64_t one = 1;
    // If it is full, it is raised already.
    if (may_use(event_.get())) (void)!::write(event_.get(), &one, sizeof one);
    errno = before;
  }

 private:
  /// Sleeps until there is something new, and returns where; null: nothing came.
  Result<std::shared_ptr<const GraphTable>> wait_for_table(milliseconds timeout) {
    const std::shared_ptr<const GraphTable> nothing;
    if (Result<void> refused = refuse_forked_child(); !refused)
      return tl::unexpected<Failure>(refused.error());
    const Clock::time_point deadline = Clock::now() + std::min(timeout, timeout_max);
    if (table_ != nullptr && pause_until(std::min(gathered_, deadline))) return nothing;
    for (;;) {
      if (auto table = changed_table()) return table;
      const std::uint64_t failures = graph_.failures().count;
      Result<void> asked = graph_.ask(seen_);
      // The present state comes at once.
      const Clock::time_point end =
          table_ != nullptr ? deadline
                            : std::max(deadline, Clock::now() + Connection::answer_timeout);
      while (asked) {
        const bool is_over = Clock::now() >= end;
        if (!is_over && sleep_until(end)) return nothing;
        if (auto table = changed_table()) return table;
        if (const auto now = graph_.failures(); now.count != failures)
          asked = tl::unexpected(failure_with(now.code, now.detail));
        else if (is_over && connection_state() != ConnectionState::connected)
          asked = fail(Errc::daemon_not_running, "the connection to agnocastd has ended");
        else if (is_over)
          return nothing;
        else
          asked = graph_.ask(seen_);
      }
      const Errc why = asked.error().code;
      if ((why != Errc::daemon_not_running && why != Errc::started_anew) ||
          Clock::now() >= deadline) {
        see(nullptr, 0);  // the next wait returns the present state
        return tl::unexpected<Failure>(asked.error());
      }
      if (pause_until(std::min(deadline, Clock::now() + reconnect_interval))) return nothing;
    }
  }
  /// Returns the table if there is something new in it, else null. The control thread may drop it
  /// at any time, so one call decides.
  std::shared_ptr<const GraphTable> changed_table() const {
    auto present = graph_.table();
    if (present != nullptr && present == table_ && present->changes() == seen_) return nullptr;
    return present;
  }
  void see(std::shared_ptr<const GraphTable> table, std::uint64_t changes) noexcept {
    table_ = std::move(table);
    seen_ = changes;
  }
  /// Returns true once it was interrupted; false at the end, or when the daemon has answered.
  bool sleep_until(Clock::time_point end) noexcept {
    pollfd entry{event_.get(), POLLIN, 0};
    for (;;) {
      if (is_interrupted_.exchange(false, std::memory_order_acquire)) return true;
      const auto left = std::chrono::ceil<milliseconds>(end - Clock::now()).count();
      if (left <= 0) return false;
      if (!may_use(event_.get())) {  // user code has closed it
        ::poll(nullptr, 0, static_cast<int>(std::min<std::int64_t>(left, gather_time.count())));
        return is_interrupted_.exchange(false, std::memory_order_acquire);
      }
      const int ready =
          ::poll(&entry, 1, static_cast<int>(std::min<std::int64_t>(left, 1'000'000)));
      std::uint64_t count = 0;
      if (ready > 0 && ::read(event_.get(), &count, sizeof count) == sizeof count)
        return is_interrupted_.exchange(false, std::memory_order_acquire);
    }
  }

  /// Returns true once it was interrupted; answers do not end it.
  bool pause_until(Clock::time_point end) noexcept {
    while (Clock::now() < end) {
      if (sleep_until(end)) return true;
    }
    return false;
  }

  HostGraph& graph_ = HostGraph::instance();
  UniqueFd event_;
  std::atomic<bool> is_interrupted_{false};
  std::shared_ptr<const GraphTable> table_;  // that of the last wait
  std::uint64_t seen_ = 0;                   // its changes then
  Clock::time_point gathered_{};             // the next wait does not end before
  std::atomic<Clock::duration> look_time_{Clock::duration::zero()};  // of the last look
  // The thread that looks has these:
  std::shared_ptr<const GraphTable> looked_at_;
  std::uint64_t looked_changes_ = 0;
  Known known_;
};

Graph::Graph() : state_(std::make_unique<State>()) {}
Graph::~Graph() = default;
Graph::Graph(Graph&&) noexcept = default;
Graph& Graph::operator=(Graph&&) noexcept = default;

Result<std::optional<GraphSnapshot>> Graph::wait(milliseconds timeout) {
  return state_->wait(timeout);
}
Result<bool> Graph::wait_for_change(milliseconds timeout) {
  return state_->wait_for_change(timeout);
}
std::optional<GraphChanges> Graph::look() { return state_->look(); }
void Graph::start_over() noexcept { state_->start_over(); }
void Graph::interrupt() noexcept { state_->interrupt(); }

}  // namespace agnocast
