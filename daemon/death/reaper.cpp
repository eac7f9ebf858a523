// SPDX-License-Identifier: Apache-2.0

#include <daemon/death/reaper.hpp>

#include <base/check.hpp>
#include <base/clock.hpp>
#include <daemon/state/steps.hpp>
#include <journal/queue_recovery.hpp>

#include <sys/sysmacros.h>

#include <cerrno>
#include <cinttypes>
#include <cstdio>
#include <memory>
#include <utility>
#include <variant>

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
                 Doorbells& doorbells, EndpointManager& endpoint_manager)
    : reason_(reason),
      registry_(registry),
      regions_(regions),
      doorbells_(doorbells),
      endpoint_manager_(endpoint_manager),
      death_(die(client, reason, registry), registry) {}

ClientIndex Reaping::die(ClientIndex client, DeathReason reason, Registry& registry) {
  if (registry.is_alive(client)) registry.client_died(client, reason);
  return client;
}

bool Reaping::go_on(std::uint64_t until_ns) {
  while (const std::optional<DeathStep> step = death_.next()) {
    const bool may_pause = std::visit([this](const auto& it) { return carry_out(it); }, *step);
    if (may_pause && monotonic_ns() >= until_ns) return false;
  }
  return true;
}

bool Reaping::carry_out(const death::Close& step) {
  endpoint_manager_.run(endpoint_manager_.endings().close_subscription(step.subscription));
  ++reaped_.subscriptions;
  return true;
}

bool Reaping::carry_out(const death::Orphan& step) {
  const EndpointRef& ref = step.publisher;
  const PublisherRecord& record = registry_.publisher(ref.topic, ref.index);
  std::uint64_t final_head = abi::pack_entry(abi::first_sequence_of(record.generation), 0);
  journal::LeaveCause cause = journal::LeaveCause::nothing_open;
  if (regions_.is_open(client())) {
    const region::PublisherWords<SharedMemory> words{regions_.region(client()), record.extent};
    AGNOCAST_CRASH_POINT(B_recover);
    if (reason_ == DeathReason::revoked) {
      cause = journal::LeaveCause::left;
      final_head = words.head().load(std::memory_order_acquire);
    } else {
      cause = count(journal::recover_queue(words, record.slot_count, final_head), reaped_);
    }
  }
  endpoint_manager_.run(endpoint_manager_.endings().orphan(ref, final_head, cause));
  ++reaped_.publishers;
  return true;
}

// Others keep their mappings; the region is announced to no new process. The process's own mapping
// stays: it may live.
bool Reaping::carry_out(const death::Unmap&) {
  regions_.unmap_client(client());
  AGNOCAST_CRASH_POINT(B_memory_closed);
  return false;
}

bool Reaping::carry_out(const death::Acknowledge& step) {
  registry_.acknowledge_topic(client(), step.topic);
  return true;
}

bool Reaping::carry_out(const death::FreeUnused& step) {
  endpoint_manager_.run(endpoint_manager_.endings().free_unused(step.ref));
  return true;
}

bool Reaping::carry_out(const death::Forget&) {
  endpoint_manager_.forget_client(client());
  doorbells_.close_client(client());
  AGNOCAST_CRASH_POINT(B_doorbells_closed);
  endpoint_manager_.run(endpoint_manager_.endings().free_unused_clients());
  endpoint_manager_.run(endpoint_manager_.endings().give_up_gone());
  return false;
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
  // No memory at all: the process is ending, and the pidfd will report it; or its first thread has
  // ended and the others, whose memory does not show here, live on.
  return !has_memory || std::ferror(maps.get()) != 0;
}

}  // namespace agnocast::daemon
