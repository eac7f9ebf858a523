// SPDX-License-Identifier: Apache-2.0

#include <daemon/reaper.hpp>

#include <base/check.hpp>
#include <base/step.hpp>
#include <journal/recovery.hpp>

#include <sys/sysmacros.h>

#include <cerrno>
#include <cinttypes>
#include <cstdio>
#include <memory>
#include <vector>

namespace agnocast::daemon {
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

Reaped reap(ClientIndex client, journal::DeathReason reason, Registry& registry, Regions& regions,
            Doorbells& doorbells, Membership& membership) {
  Reaped reaped;
  if (registry.is_alive(client)) registry.client_died(client, reason);
  const std::vector<EndpointRef> endpoints = registry.endpoints_of(client);  // they go one by one
  for (const EndpointRef& ref : endpoints) {
    if (ref.kind != Kind::subscription) continue;
    const EndpointState state = registry.subscription(ref.topic, ref.index).state;
    if (state != EndpointState::active && state != EndpointState::leaving) continue;
    membership.bury_subscription(ref);
    ++reaped.subscriptions;
  }
  for (const EndpointRef& ref : endpoints) {
    if (ref.kind != Kind::publisher) continue;
    const PublisherRecord& record = registry.publisher(ref.topic, ref.index);
    if (record.state != EndpointState::active) continue;
    std::uint64_t final_head = abi::pack_entry(abi::first_sequence_of(record.generation), 0);
    if (!regions.is_open(client)) {
      membership.orphan(ref, final_head, journal::LeaveCause::nothing_open);
      ++reaped.publishers;
      continue;
    }
    const dataplane::PublisherWords<SharedMemory> words{regions.region(client), record.extent};
    AGNOCAST_CRASH_POINT(B_recover);
    journal::LeaveCause cause = journal::LeaveCause::left;
    if (reason == journal::DeathReason::revoked) {
      final_head = words.head().load(std::memory_order_acquire);
    } else {
      cause = count(journal::recover_queue(words, record.slot_count, final_head), reaped);
    }
    membership.orphan(ref, final_head, cause);
    ++reaped.publishers;
  }
  membership.forget_client(client);
  doorbells.close_client(client);
  AGNOCAST_CRASH_POINT(B_bells_closed);
  // Others keep what they map; nobody new is told of it.
  regions.bury_client(client);
  AGNOCAST_CRASH_POINT(B_buried);
  membership.settle_all();
  membership.limit_gone();
  return reaped;
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
