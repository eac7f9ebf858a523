// SPDX-License-Identifier: Apache-2.0
//
// The configurations that the explorer runs. Letters: M messages, K publisher depth, D
// subscription depth; s0 was subscribed before the publisher came and links at any time, s1 joins
// while it publishes.
#pragma once

#include <tests/model/queue_scenario.hpp>

namespace agnocast::model {

inline constexpr SubscriptionPlan none_planned{};

constexpr SubscriptionPlan early(std::uint32_t depth) { return {.present = true, .depth = depth}; }
constexpr SubscriptionPlan linked(std::uint32_t depth) {
  return {.present = true, .linked = true, .depth = depth};
}
constexpr SubscriptionPlan late(std::uint32_t depth, bool transient_local = false) {
  return {.present = true, .late = true, .depth = depth, .transient_local = transient_local};
}
constexpr SubscriptionPlan holding(SubscriptionPlan plan, std::uint32_t quota) {
  plan.quota = quota;
  return plan;
}
constexpr SubscriptionPlan sleeping_while_holding(SubscriptionPlan plan, std::uint32_t quota) {
  plan.quota = quota;
  plan.sleep_holding = true;
  return plan;
}
constexpr SubscriptionPlan releasing_elsewhere(SubscriptionPlan plan, std::uint32_t quota) {
  plan.quota = quota;
  plan.other_thread_releases = true;
  return plan;
}
constexpr SubscriptionPlan leaving(SubscriptionPlan plan, bool rejoins) {
  plan.leaves = true;
  plan.rejoins = rejoins;
  return plan;
}
constexpr SubscriptionPlan replaced_by_another(SubscriptionPlan plan, std::uint32_t depth) {
  plan.rejoin_depth = depth;
  return plan;
}
constexpr SubscriptionPlan hanging(SubscriptionPlan plan) {
  plan.hangs = true;
  return plan;
}
constexpr SubscriptionPlan keeping_all(SubscriptionPlan plan) {
  plan.keep_all = true;
  return plan;
}

constexpr SubscriptionPlan withdrawn(SubscriptionPlan plan) {
  plan.withdrawn = true;
  return plan;
}
constexpr SubscriptionPlan unmapped(SubscriptionPlan plan, bool served_again) {
  plan.withdrawn = true;
  plan.unmapped = true;
  plan.served_again = served_again;
  return plan;
}

constexpr SubscriptionPlan without_window(SubscriptionPlan plan, std::uint32_t window) {
  plan.cannot_map = window;
  return plan;
}

// Small enough to run once per mutant, together wide enough to notice each. Ordered by cost.
inline constexpr QueuePlan mutant_plans[] = {
    {.name = "s0 M=2 K=1 D=2", .messages = 2, .sub = {early(2), none_planned}},
    {.name = "s0 M=3 K=1 D=1 volatile, holds 2, sleeps while holding",
     .messages = 3,
     .transient_local = false,
     .sub = {sleeping_while_holding(early(1), 2), none_planned}},
    {.name = "s0 M=3 K=1 D=2, the heap grows",
     .messages = 3,
     .grow_before = 2,
     .sub = {early(2), none_planned}},
    {.name = "s0 hangs M=4 K=1 D=1, few slots",
     .messages = 4,
     .slots = 3,
     .sub = {hanging(early(1)), none_planned}},
    {.name = "s0 M=2 K=2 D=2, publisher leaves",
     .messages = 2,
     .depth = 2,
     .sub = {early(2), none_planned},
     .publisher_leaves = true},
    {.name = "s0 M=2 K=1 D=1, publisher dies",
     .messages = 2,
     .sub = {early(1), none_planned},
     .publisher_deaths = 1},
    {.name = "s0 M=2 K=1 D=2, subscriber dies",
     .messages = 2,
     .sub = {early(2), none_planned},
     .subscriber_deaths = 1},
    {.name = "s0 M=4 K=2 D=3, ring exactly D+1",
     .messages = 4,
     .depth = 2,
     .slots = 5,
     .sub = {early(3), none_planned}},
    {.name = "s1 late M=3 K=2 D=2 transient_local",
     .messages = 3,
     .depth = 2,
     .sub = {none_planned, late(2, true)}},
    {.name = "s1 late M=3 D=2 volatile",
     .messages = 3,
     .transient_local = false,
     .sub = {none_planned, late(2)}},
    {.name = "s1 late M=2 K=1 D=1, publisher and daemon die",
     .messages = 2,
     .sub = {none_planned, late(1)},
     .publisher_deaths = 1,
     .daemon_deaths = 1,
     .store_buffers = false},
    {.name = "s0 M=2 keep_all(1)",
     .messages = 2,
     .keep_all = true,
     .sub = {keeping_all(early(1)), none_planned}},
    {.name = "s1 late M=2 K=1 D=1, leaves and joins again",
     .messages = 2,
     .sub = {none_planned, leaving(late(1), true)},
     .store_buffers = false},
    {.name = "s1 late M=2 D=1, another process joins with D=2",
     .messages = 2,
     .transient_local = false,
     .sub = {none_planned, replaced_by_another(late(1), 2)},
     .store_buffers = false},
    {.name = "s1 late M=2 requests what is not offered",
     .messages = 2,
     .transient_local = false,
     .sub = {none_planned, late(2, true)}},
    {.name = "s1 late M=2 D=1 sleeps while holding, its join brings a slot",
     .messages = 2,
     .transient_local = false,
     .slots = 2,
     .slots_before = 1,
     .sub = {none_planned, sleeping_while_holding(late(1), 2)},
     .store_buffers = false},
    {.name = "s0 M=2 K=1 D=2, the second one in another window",
     .messages = 2,
     .second_window_from = 2,
     .sub = {early(2), none_planned}},
    {.name = "s0 M=2 K=1 D=2, the second one points into another window",
     .messages = 2,
     .second_window_from = 2,
     .second_has_members = true,
     .sub = {early(2), none_planned}},
    {.name = "s0 M=2 K=1 D=2, it can never map the window of the first one",
     .messages = 2,
     .second_window_from = 2,
     .second_is_fresh = true,
     .sub = {without_window(early(2), 1), none_planned}},
    {.name = "s0 M=2 K=1 D=2, it can never map where the second one points",
     .messages = 2,
     .second_window_from = 2,
     .second_has_members = true,
     .sub = {without_window(early(2), 2), none_planned}},
    {.name = "s0 M=3 K=1 D=1 volatile is withdrawn, holds 2",
     .messages = 3,
     .transient_local = false,
     .sub = {withdrawn(sleeping_while_holding(linked(1), 2)), none_planned}},
    {.name = "s0 M=2 D=1 volatile is never mapped, withdrawn and disregarded",
     .messages = 2,
     .transient_local = false,
     .sub = {unmapped(early(1), false), none_planned}},
    {.name = "s0 M=2 D=1 volatile is mapped late and served again",
     .messages = 2,
     .transient_local = false,
     .sub = {unmapped(early(1), true), none_planned}},
    {.name = "s1 late M=1 K=1 D=1, leaves and joins again, the publisher leaves",
     .messages = 1,
     .sub = {none_planned, leaving(late(1, true), true)},
     .store_buffers = false,
     .publisher_leaves = true},
};

// Two subscriptions of one process: one sleep word, one number at the publisher, one doorbell.
// Deferred scans, so that the schedules are about rings.
inline constexpr QueuePlan one_executor_for_linked = {
    .name = "one executor for s0 and s1, both linked: M=3 D=2/1",
    .messages = 3,
    .transient_local = false,
    .deferred_limit = 3,
    .sub = {linked(2), linked(1)},
    .one_executor = true};
inline constexpr QueuePlan one_executor_for_late = {
    .name = "one executor for s0 and late s1: M=1 D=1/1",
    .messages = 1,
    .deferred_limit = 1,
    .sub = {linked(1), late(1, true)},
    .store_buffers = false,
    .one_executor = true};

// The actual proof.
inline constexpr QueuePlan proof_plans[] = {
    {.name = "s0 M=4 K=1 D=3 ring exactly D+1, P and S die",
     .messages = 4,
     .slots = 5,
     .sub = {early(3), none_planned},
     .publisher_deaths = 1,
     .subscriber_deaths = 1,
     .store_buffers = false},
    {.name = "s0 M=3 K=1 D=2, P and S die",
     .messages = 3,
     .sub = {early(2), none_planned},
     .publisher_deaths = 1,
     .subscriber_deaths = 1},
    {.name = "s0 M=3 volatile D=3, P and S die",
     .messages = 3,
     .transient_local = false,
     .sub = {early(3), none_planned},
     .publisher_deaths = 1,
     .subscriber_deaths = 1},
    {.name = "s0 M=4 K=3 D=1",
     .messages = 4,
     .depth = 3,
     .slots = 5,
     .sub = {early(1), none_planned}},
    {.name = "s0 M=3 D=3 holds 2, may sleep while holding",
     .messages = 3,
     .sub = {sleeping_while_holding(early(3), 2), none_planned}},
    {.name = "s0 M=3 slots run out (N=2)",
     .messages = 3,
     .slots = 2,
     .sub = {sleeping_while_holding(early(2), 2), none_planned},
     .store_buffers = false,
     .may_run_out_of_slots = true},
    {.name = "s0 M=3 D=3, another thread releases",
     .messages = 3,
     .sub = {releasing_elsewhere(early(3), 2), none_planned}},
    {.name = "s0 M=3 keep_all(1)",
     .messages = 3,
     .keep_all = true,
     .sub = {keeping_all(early(1)), none_planned}},
    {.name = "s0 M=3 keep_all(2) transient_local",
     .messages = 3,
     .depth = 2,
     .keep_all = true,
     .sub = {keeping_all(early(2)), none_planned}},
    {.name = "s0 M=3 keep_all(2) volatile",
     .messages = 3,
     .depth = 2,
     .transient_local = false,
     .keep_all = true,
     .sub = {keeping_all(early(2)), none_planned}},
    {.name = "s1 late M=3 keep_all(2) transient_local",
     .messages = 3,
     .depth = 2,
     .keep_all = true,
     .sub = {none_planned, keeping_all(late(2, true))}},
    {.name = "s1 late M=2 K=1 D=2, P, S and D die",
     .messages = 2,
     .sub = {none_planned, late(2, true)},
     .publisher_deaths = 1,
     .subscriber_deaths = 1,
     .daemon_deaths = 1,
     .store_buffers = false},
    {.name = "s1 late M=2 K=2 D=1, D dies twice",
     .messages = 2,
     .depth = 2,
     .sub = {none_planned, late(1, true)},
     .daemon_deaths = 2},
    {.name = "s1 late M=3 K=1 D=3 volatile",
     .messages = 3,
     .transient_local = false,
     .sub = {none_planned, late(3)}},
    {.name = "s1 late M=3 K=2 D=3 holds 2",
     .messages = 3,
     .depth = 2,
     .sub = {none_planned, holding(late(3, true), 2)}},
    {.name = "s1 late M=3 D=2 volatile, leaves",
     .messages = 3,
     .transient_local = false,
     .sub = {none_planned, leaving(late(2), false)},
     .store_buffers = false},
    {.name = "s1 late M=2 K=2 D=2, the publisher leaves, D dies",
     .messages = 2,
     .depth = 2,
     .sub = {none_planned, late(2, true)},
     .daemon_deaths = 1,
     .store_buffers = false,
     .publisher_leaves = true},
    {.name = "deferred scans: s0 M=4 D=2",
     .messages = 4,
     .deferred_limit = 2,
     .sub = {early(2), none_planned}},
    {.name = "deferred scans: s1 late M=3 D=2 volatile, D dies",
     .messages = 3,
     .transient_local = false,
     .deferred_limit = 1,
     .sub = {none_planned, late(2)},
     .daemon_deaths = 1,
     .store_buffers = false},
    {.name = "growth: s0 M=3 D=2, P dies",
     .messages = 3,
     .grow_before = 2,
     .sub = {early(2), none_planned},
     .publisher_deaths = 1},
    {.name = "growth: s1 late M=3 K=2 D=2",
     .messages = 3,
     .depth = 2,
     .grow_before = 3,
     .sub = {none_planned, late(2, true)}},
    {.name = "s1 late M=3 K=2 D=2, it can never map the window of the first one",
     .messages = 3,
     .depth = 2,
     .second_window_from = 2,
     .second_is_fresh = true,
     .sub = {none_planned, without_window(late(2, true), 1)},
     .store_buffers = false},
    {.name = "s0 M=3 K=1 D=2, it can never map the first window, P dies",
     .messages = 3,
     .second_window_from = 2,
     .second_is_fresh = true,
     .sub = {without_window(early(2), 1), none_planned},
     .publisher_deaths = 1,
     .store_buffers = false},
    {.name = "s0 M=3 D=2 is withdrawn, P and S die",
     .messages = 3,
     .sub = {withdrawn(early(2)), none_planned},
     .publisher_deaths = 1,
     .subscriber_deaths = 1,
     .store_buffers = false},
    {.name = "s0 M=3 D=2 holds 2, is withdrawn",
     .messages = 3,
     .sub = {withdrawn(holding(early(2), 2)), none_planned}},
    {.name = "s0 M=2 keep_all(1) is never mapped and withdrawn",
     .messages = 2,
     .keep_all = true,
     .sub = {unmapped(keeping_all(early(1)), false), none_planned}},
    {.name = "s1 late M=2 K=1 D=1 is withdrawn, leaves and joins again",
     .messages = 2,
     .sub = {none_planned, withdrawn(leaving(late(1, true), true))},
     .store_buffers = false},
    {.name = "s0 M=3 K=2 D=2 is mapped late and served again, P dies",
     .messages = 3,
     .depth = 2,
     .sub = {unmapped(early(2), true), none_planned},
     .publisher_deaths = 1,
     .store_buffers = false},
    one_executor_for_linked,
    {.name = "one executor for s0 and early s1: M=1 D=1/1",
     .messages = 1,
     .transient_local = false,
     .sub = {linked(1), early(1)},
     .one_executor = true},
    one_executor_for_late,
    {.name = "s0 and s1 together: M=1 D=2/1",
     .messages = 1,
     .sub = {early(2), late(1, true)},
     .store_buffers = false},
};

// Deliberate faults, each with the violation that must be noticed: the publisher numbers wait
// sets, and two subscriptions may share a number and a doorbell.
struct FaultyPlan {
  const char* name;
  QueuePlan plan;
  QueueFault fault = QueueFault::none;
  Mutation mutation{};
  const char* violation = "a subscription sleeps beside a message";
};
inline constexpr FaultyPlan faulty_plans[] = {
    {.name = "two processes under one number",
     .plan = {.messages = 1,
              .transient_local = false,
              .sub = {linked(1), linked(1)},
              .store_buffers = false},
     .fault = QueueFault::one_number_for_two_wait_sets},
    {.name = "one executor looks at its last link only",
     .plan = one_executor_for_linked,
     .fault = QueueFault::looks_at_last_link},
    {.name = "one executor is not woken by a link",
     .plan = one_executor_for_late,
     .fault = QueueFault::links_without_waking},
    {.name = "one executor is not rung",
     .plan = one_executor_for_linked,
     .mutation = {steps::P8_ring, Mutation::Kind::leave_out}},
    {.name = "one executor is rung for each subscription",
     .plan = one_executor_for_linked,
     .mutation = {steps::P8_rung, Mutation::Kind::leave_out},
     .violation = "one sleep was rung twice"},
};

}  // namespace agnocast::model
