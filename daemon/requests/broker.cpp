// SPDX-License-Identifier: Apache-2.0
//
// Broker: see the header.

#include <daemon/requests/broker.hpp>

#include <base/check.hpp>
#include <base/clock.hpp>
#include <daemon/requests/recovery.hpp>
#include <daemon/state/steps.hpp>

#include <fcntl.h>

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

namespace agnocast::daemon {

namespace {

// Interval of looks at processes without a connection.
constexpr int short_interval_ms = 250;
// Interval of looks at holds, at outstanding unmaps and at doorbells.
constexpr int watch_interval_ms = 1'000;

}  // namespace

// Long because it builds each part once, in the order in which they need one another.
Broker::Broker(const BrokerOptions& options, Log& log, Dispatcher& dispatcher, Listener& listener,
               Regions regions, DescriptorStore& store, Errands& errands, Disposal& disposal)
    : options_(options),
      log_(log),
      dispatcher_(dispatcher),
      listener_(listener),
      store_(store),
      connections_(dispatcher, disposal),
      output_({options.config.quota.queued_bytes,
               options.config.quota.queued_seconds == unlimited
                   ? std::nullopt
                   : std::optional(options.config.quota.queued_seconds)},
              connections_, dispatcher, log),
      regions_(std::move(regions)),
      registry_(regions_.memory(),
                {options.config.limits.clients, options.config.limits.topics,
                 options.config.limits.publishers_per_topic,
                 options.config.limits.subscriptions_per_topic,
                 options.config.limits.slots_per_publisher, options.config.limits.depth_max}),
      access_(options_.config.access, registry_, log),
      plan_(options.arena, options.former_count),
      obstacles_(options.arena),
      doorbells_(
          listener.doorbells_directory(), store,
          [&disposal](std::uint32_t uid, UniqueFd fd) { disposal.close(uid, std::move(fd)); }),
      endpoint_manager_(registry_, regions_, doorbells_, output_),
      admission_(options_.config, options_.arena, plan_, registry_, endpoint_manager_, store,
                 access_),
      conflicts_(options_.config.heap, options_.arena, registry_, admission_, plan_, obstacles_,
                 endpoint_manager_, output_, log),
      reaping_(registry_, regions_, doorbells_, endpoint_manager_),
      region_look_(connections_, errands, regions_),
      termination_(connections_, dispatcher, registry_, store, obstacles_, endpoint_manager_,
                   reaping_, region_look_, log),
      scheduler_(connections_, dispatcher, termination_),
      namespaces_(connections_, errands, scheduler_),
      collector_({options_.config, options_.arena, plan_, registry_, regions_, doorbells_,
                  obstacles_, admission_, refusals_, store, connections_, log}),
      answers_(options_.config.quota, registry_, collector_, connections_, output_, termination_),
      observer_requests_(options_.config.access, registry_, regions_, admission_, connections_,
                         output_, termination_, answers_, log),
      graph_requests_(registry_, connections_, output_),
      hold_watch_(registry_, regions_),
      unmap_watch_(registry_, regions_, endpoint_manager_.endings(), output_),
      readers_(registry_, doorbells_, log),
      refusal_report_(registry_, admission_, refusals_, output_, log),
      server_(admission_, conflicts_, refusal_report_, termination_),
      hello_requests_({options_.arena, registry_, regions_, store, admission_, connections_,
                       output_, scheduler_, region_look_, termination_, server_, log}),
      rejoin_requests_({registry_, doorbells_, endpoint_manager_, access_, conflicts_, unmap_watch_,
                        connections_, output_, termination_, log}),
      window_requests_(options_.arena, registry_, regions_, plan_, endpoint_manager_, conflicts_,
                       admission_, output_, log),
      wait_set_requests_(registry_, doorbells_, admission_, output_),
      endpoint_requests_(options_.config, registry_, regions_, endpoint_manager_, admission_,
                         scheduler_, server_, refusal_report_, readers_, log),
      acknowledgement_requests_(endpoint_manager_, conflicts_, readers_),
      thread_requests_(options_.config, registry_, connections_, errands, log_),
      reader_(connections_, output_, disposal, scheduler_, termination_, server_),
      acceptor_({options_.config.quota, listener, dispatcher, disposal, registry_, admission_,
                 connections_, scheduler_, namespaces_, log}) {
  regions_.use(errands);
  output_.set_before_flush([this] { graph_requests_.write(); });
  endpoint_manager_.use_wide_topics(options_.config.limits.wide_topics);
  fill_request_table();
  endpoint_manager_.on_client_freed = [this](ClientIndex client) { free_client(client); };
  endpoint_manager_.set_on_matched(
      [this](const EndpointRef& publisher, const EndpointRef& subscription) {
        conflicts_.look_at(publisher, subscription);
      });
}

void Broker::fill_request_table() {
  RequestTable& table = server_.handlers();
  table.add(hello_requests_, &HelloRequests::hello);
  table.add(rejoin_requests_, &RejoinRequests::rejoin);
  table.add(window_requests_, &WindowRequests::open_window);
  table.add(window_requests_, &WindowRequests::bring_window);
  table.add(wait_set_requests_, &WaitSetRequests::open_wait_set);
  table.add(endpoint_requests_, &EndpointRequests::create);
  table.add(endpoint_requests_, &EndpointRequests::leave);
  table.add(acknowledgement_requests_, &AcknowledgementRequests::drained);
  table.add(acknowledgement_requests_, &AcknowledgementRequests::unlinked);
  table.add(acknowledgement_requests_, &AcknowledgementRequests::blocked);
  table.add(acknowledgement_requests_, &AcknowledgementRequests::withdrawn);
  table.add(thread_requests_, &ThreadRequests::callback_group);
  table.add(thread_requests_, &ThreadRequests::callback_thread);
  table.add(graph_requests_, &GraphRequests::watch);
  table.add(observer_requests_, &ObserverRequests::observe);
  table.add(observer_requests_, &ObserverRequests::dump);
  table.add(observer_requests_, &ObserverRequests::read_journal);
  table.add(observer_requests_, &ObserverRequests::revoke);
  table.add(observer_requests_, &ObserverRequests::set_log_level);
  table.add(observer_requests_, &ObserverRequests::ask_access);
  AGNOCAST_CHECK(table.is_complete());  // now, not when a client sends one
}

Result<void> Broker::format(std::uint64_t incarnation) {
  const Arena& arena = options_.arena;
  registry_.create(incarnation, {arena.base, arena.bytes, arena.window_bytes, monotonic_ns(),
                                 listener_.doorbells_directory()});
  if (auto kept = regions_.keep(); !kept) return kept;
  return listener_.keep(store_);
}

Result<void> Broker::resume() {
  if (auto opened = registry_.open(); !opened) return opened;
  const TableHeader& header = registry_.header();
  options_.arena = {header.arena_base, header.arena_bytes, header.window_bytes};
  plan_ = AddressPlan(options_.arena, options_.former_count);
  return Recovery({options_.arena, plan_, registry_, regions_, doorbells_, endpoint_manager_,
                   store_, dispatcher_, connections_, scheduler_, namespaces_, termination_, log_})
      .run();
}

Result<void> Broker::start() { return acceptor_.start(); }

void Broker::serve_waiting() {
  scheduler_.serve(
      [this](PeerId id, const TimeSlice& slice) { return reader_.serve_slice(id, slice); });
  // The user of a connection that has just ended may open another one.
  acceptor_.accept_some();
}

void Broker::tick() {
  reaping_.go_on();
  thread_requests_.go_on();
  const std::uint64_t now = monotonic_ms();
  if (now - looked_ms_ >= short_interval_ms) look_around(now);  // however many events there are
  graph_requests_.go_on(now);  // changes were made above and by the events
  answers_.go_on();
}

void Broker::look_around(std::uint64_t now) {
  looked_ms_ = now;
  endpoint_requests_.refuse_uncleared(now);
  acceptor_.listen_again();
  output_.go_on_flushing();
  termination_.look_at_detached();
  endpoint_manager_.go_on_announcing();
  endpoint_manager_.announce_renewed();
  announce_what_waits();
  answers_.drop_slow(now);
  output_.end_old(now);
  connections_.give_memory_back();
  answers_.forget_idle_users(now);
  graph_requests_.forget_idle(now);
  if (now - watched_ms_ >= watch_interval_ms) {
    watched_ms_ = now;
    watch_holds();
    watch_unmapping();
    readers_.look_for_silent_doorbells(now);
  }
  log_.flush();
}

void Broker::announce_what_waits() {
  if (!endpoint_manager_.has_waiting()) return;
  log_.write_limited("announcement", LogLevel::error, "announcement waits",
                     {{"why", "no descriptor left; raise LimitNOFILE"}});
  const bool has_descriptor{UniqueFd(::open("/dev/null", O_RDONLY | O_CLOEXEC))};
  if (has_descriptor) endpoint_manager_.announce_waiting();
}

int Broker::due_ms() const noexcept {
  if (!scheduler_.nobody_waits() || !reaping_.is_empty() || thread_requests_.has_due()) return 0;
  if (acceptor_.pauses()) return short_interval_ms;
  const int answers_due = answers_.due_ms(), graph_due = graph_requests_.due_ms(monotonic_ms());
  if (answers_due >= 0 || graph_due >= 0)
    return std::min({answers_due >= 0 ? answers_due : short_interval_ms,
                     graph_due >= 0 ? graph_due : short_interval_ms, short_interval_ms});
  if (connections_.detached_count() > 0 || output_.flushes_later() ||
      endpoint_manager_.has_waiting() || endpoint_manager_.is_announcing() ||
      endpoint_manager_.has_renewed() || endpoint_requests_.has_uncleared())
    return short_interval_ms;
  return connections_.all().empty() ? 10'000 : watch_interval_ms;
}

void Broker::watch_holds() {
  for (const HoldWatch::Finding& liar : hold_watch_.look()) {
    // Revoking another process may have freed this place.
    if (!registry_.is_used(liar.subscription)) continue;
    Peer* const peer = connections_.of_client(registry_.owner_of(liar.subscription));
    if (peer == nullptr) continue;
    termination_.revoke(
        *peer, "its subscription to " + std::string(registry_.topic(liar.subscription.topic).name) +
                   " holds " + std::to_string(liar.held) +
                   " messages of one publisher, its quota is " + std::to_string(liar.quota));
  }
}

void Broker::watch_unmapping() {
  for (const UnmapWatch::Finding& found : unmap_watch_.look()) {
    if (connections_.of_client(found.client) == nullptr) continue;
    // Its acknowledgement may be waiting for a time slice.
    reader_.read(connections_.of_client(found.client)->id, TimeSlice());
    Peer* const peer = connections_.of_client(found.client);
    if (peer == nullptr || !unmap_watch_.is_true(found)) continue;
    const EndpointRef& oldest = found.oldest;
    termination_.revoke(*peer, "it has not unmapped " + std::to_string(found.count) +
                                   " endpoints that are gone, the oldest a " +
                                   (oldest.kind == Kind::publisher ? "publisher" : "subscription") +
                                   " of " + printable(registry_.topic(oldest.topic).name));
  }
}

void Broker::free_client(ClientIndex client) {
  AGNOCAST_CRASH_POINT(B_place_free);
  regions_.close_client(client);
  const ClientRecord& record = registry_.client(client);
  for (std::uint64_t w = 0; w < record.window_count; ++w)
    AGNOCAST_CHECK(plan_.give_back(record.window[w].base));
  log_.write(LogLevel::debug, "client place free",
             {{"client", number(client)}, {"generation", record.generation}});
}

}  // namespace agnocast::daemon
