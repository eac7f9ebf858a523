// SPDX-License-Identifier: Apache-2.0

#include <daemon/death/reaper.hpp>

#include <base/check.hpp>
#include <base/clock.hpp>
#include <daemon/state/steps.hpp>
#include <journal/recovery.hpp>

#include <sys/sysmacros.h>

#include <cerrno>
#include <cinttypes>
#include <cstdio>
#include <memory>
#include <utility>

namespace agnocast::daemon {

using journal::DeathReason;

namespace {

journal::LeaveCause count(journal::IntentDecision decision, Reaped& reaped) noexcept {
  switch (decision) {
    case journal::IntentDecision::nothing:
      break;
    case journal::IntentDecision::roll_back:
      ++reaped.rolled_back;
      return journal::LeaveCause::rolled_back;
    case journal::IntentDecision::roll_forward:
      ++reaped.rolled_forward;
      return journal::LeaveCause::rolled_forward;
    case journal::IntentDecision::corrupt:
      ++reaped.corrupt;
      return journal::LeaveCause::corrupt;
  }
  return journal::LeaveCause::nothing_open;
}

}  // namespace

Reaping::Reaping(ClientIndex client, DeathReason reason, Registry& registry, Regions& regions,
                 Doorbells& doorbells, Membership& membership)
    : client_(client),
      reason_(reason),
      registry_(registry),
      regions_(regions),
      doorbells_(doorbells),
      membership_(membership) {
  if (registry_.is_alive(client_)) registry_.client_died(client_, reason_);
  endpoints_ = registry_.endpoints_of(client_);
  for (const EndpointRef& ref : endpoints_) topics_.insert(ref.topic);
}

bool Reaping::go_on(std::uint64_t until_ns) {
  while (next_subscription_ < endpoints_.size()) {
    if (end_subscription(endpoints_[next_subscription_++]) && monotonic_ns() >= until_ns)
      return false;
  }
  while (next_publisher_ < endpoints_.size()) {
    if (end_publisher(endpoints_[next_publisher_++]) && monotonic_ns() >= until_ns) return false;
  }
  // Others keep what they map; nobody new is told of it. What it has itself stays as it is: it may live.
  if (!std::exchange(buried_, true)) {
    regions_.bury_client(client_);
    AGNOCAST_CRASH_POINT(B_buried);
  }
  while (settle_next()) {
    if (monotonic_ns() >= until_ns) return false;
  }
  if (!std::exchange(done_, true)) finish();
  return true;
}

// A place that was free by the time may be somebody else's by now.
bool Reaping::is_ours(const EndpointRef& ref) const noexcept {
  return registry_.is_used(ref) && registry_.owner_of(ref) == client_;
}

bool Reaping::end_subscription(const EndpointRef& ref) {
  if (ref.kind != Kind::subscription || !is_ours(ref)) return false;
  const EndpointState state = registry_.subscription(ref.topic, ref.index).state;
  if (state != EndpointState::active && state != EndpointState::leaving) return false;
  membership_.bury_subscription(ref);
  ++reaped_.subscriptions;
  return true;
}

bool Reaping::end_publisher(const EndpointRef& ref) {
  if (ref.kind != Kind::publisher || !is_ours(ref)) return false;
  const PublisherRecord& record = registry_.publisher(ref.topic, ref.index);
  if (record.state != EndpointState::active) return false;
  std::uint64_t final_head = abi::pack_entry(abi::first_sequence_of(record.generation), 0);
  journal::LeaveCause cause = journal::LeaveCause::nothing_open;
  if (regions_.is_open(client_)) {
    const region::PublisherWords<SharedMemory> words{regions_.region(client_), record.extent};
    AGNOCAST_CRASH_POINT(B_recover);
    if (reason_ == DeathReason::revoked) {
      cause = journal::LeaveCause::left;
      final_head = words.head().load(std::memory_order_acquire);
    } else {
      cause = count(journal::recover_queue(words, record.slot_count, final_head), reaped_);
    }
  }
  membership_.orphan(ref, final_head, cause);
  ++reaped_.publishers;
  return true;
}

// What nobody has any more lies in the topics that it knew, and in those of its own endpoints. Nothing of it is
// active by now, so it is told of nothing again.
bool Reaping::settle_next() {
  if (!to_settle_.empty()) {
    const EndpointRef ref = to_settle_.back();
    to_settle_.pop_back();
    membership_.settle(ref);
    return true;
  }
  std::optional<TopicIndex> topic = registry_.known_topic_of(client_);
  if (!topic && !topics_.empty()) topic = *topics_.begin();
  if (!topic) return false;
  topics_.erase(*topic);
  registry_.forget_in_topic(client_, *topic);
  for (const Kind kind : {Kind::subscription, Kind::publisher}) {
    for (auto at = registry_.next_place(kind, *topic, 0); at;
         at = registry_.next_place(kind, *topic, *at + 1))
      to_settle_.push_back({kind, *topic, *at});
  }
  return true;
}

void Reaping::finish() {
  membership_.forget_client(client_);
  doorbells_.close_client(client_);
  AGNOCAST_CRASH_POINT(B_bells_closed);
  membership_.settle_clients();
  membership_.limit_gone();
}

std::optional<bool> maps_file(pid_t pid, const Regions::FileId& file) noexcept {
  if (pid <= 0) return true;
  char path[64];
  std::snprintf(path, sizeof path, "/proc/%ld/maps", static_cast<long>(pid));
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> maps(std::fopen(path, "re"), &std::fclose);
  if (maps == nullptr && (errno == EMFILE || errno == ENFILE || errno == ENOMEM))
    return std::nullopt;
  if (maps == nullptr) return true;
  // address-address rights offset major:minor inode path
  char line[512];
  bool whole_before = true, has_memory = false;
  while (std::fgets(line, sizeof line, maps.get()) != nullptr) {
    has_memory = true;
    const bool starts_here = whole_before;
    whole_before = false;
    for (const char* at = line; *at != '\0'; ++at) whole_before = whole_before || *at == '\n';
    unsigned device_major = 0, device_minor = 0;
    std::uint64_t inode = 0;
    if (starts_here &&
        std::sscanf(line, "%*x-%*x %*s %*x %x:%x %" SCNu64, &device_major, &device_minor, &inode) ==
            3 &&
        inode == file.inode && makedev(device_major, device_minor) == file.device)
      return true;
  }
  // No memory at all: it is ending, and the pidfd will say so; or its first thread has ended and the
  // others, whose memory does not show here, live on.
  return !has_memory || std::ferror(maps.get()) != 0;
}

}  // namespace agnocast::daemon
