// SPDX-License-Identifier: Apache-2.0
//
// A run of the queue scenario: the participants, their quality of service, which of them may die,
// and what the plan breaks on purpose. plans.hpp has the plans themselves.
#pragma once

#include <cstdint>

namespace agnocast::model {

struct SubscriptionPlan {
  bool present = false;
  bool late = false;    // joins while the publisher runs; otherwise it exists before
  bool linked = false;  // and is linked and mapped when the publisher starts
  std::uint32_t depth = 1;
  bool transient_local = false;
  bool keep_all = false;
  std::uint32_t quota = 1;     // messages held at once
  bool sleep_holding = false;  // may sleep while it holds messages
  bool other_thread_releases = false;
  bool leaves = false;  // may leave after any take
  bool rejoins = false;
  // Another process with this depth takes its place after it was woken twice, or when there is a
  // message to take; 0 = none. A ring meant for the first process must not affect the second.
  std::uint32_t rejoin_depth = 0;
  bool hangs = false;            // links and then never takes, as if stopped
  std::uint32_t cannot_map = 0;  // window of the publisher, from 1; 0 = it can map all
  // The publisher withdraws it at any time, for good.
  bool withdrawn = false;
  // The publisher cannot map it before it is withdrawn and holds no message: then it is
  // disregarded, or, with served_again, mapped and served.
  bool unmapped = false;
  bool served_again = false;
};

/// Deliberate faults of a plan for which no named step exists.
enum class QueueFault : std::uint8_t {
  none,
  one_number_for_two_wait_sets,  // two processes; the number has the doorbell of the first
  looks_at_last_link,            // before it sleeps, the executor checks only its second link
  links_without_waking,          // a link made while the executor sleeps does not wake it
};

struct QueuePlan {
  const char* name = "";
  std::uint32_t messages = 3;
  std::uint32_t depth = 1;
  bool transient_local = true;
  bool keep_all = false;
  std::uint64_t slots = 4;
  std::uint64_t slots_before =
      0;  // raised to `slots` by the first join; 0 = `slots` from the start
  std::uint64_t ring = 4;
  std::uint64_t deferred_limit = 0;
  std::uint32_t grow_before = 0;         // the heap grows before this message (1-based); 0 = never
  std::uint32_t second_window_from = 0;  // messages from this one on lie there; 0 = never
  bool second_has_members = false;  // they only point there: the objects lie in the first window
  bool second_is_fresh = false;     // it begins a window set
  SubscriptionPlan sub[2];
  std::uint32_t publisher_deaths = 0;
  std::uint32_t subscriber_deaths = 0;
  std::uint32_t daemon_deaths = 0;
  bool store_buffers = true;
  bool may_run_out_of_slots = false;
  bool publisher_leaves = false;  // after its last message; its process stays
  // Both subscriptions belong to one process and one executor: one sleep word, one number, one
  // doorbell. sub0 is the executor's thread and takes for both; sub1 is the thread that joins and
  // links the second one. No process dies or leaves in such a plan.
  bool one_executor = false;
  QueueFault fault = QueueFault::none;
};

}  // namespace agnocast::model
