// SPDX-License-Identifier: Apache-2.0
//
// Quality of service: what a profile leaves open, and whether two profiles go together (DDS 1.4,
// 2.2.3: what is offered must be at least what is requested).

#include <ros2/rmw_agnocast_cpp/src/common.hpp>

#include <rmw/qos_profiles.h>
#include <rmw/time.h>
#include <rmw/types.h>

#include <cstring>
#include <string>

using namespace agnocast;
using namespace agnocast::rmw;

namespace agnocast::rmw {

bool resolve_qos(const rmw_qos_profile_t& asked, rmw_qos_profile_t& resolved) {
  resolved = asked;
  if (asked.history == RMW_QOS_POLICY_HISTORY_UNKNOWN ||
      asked.reliability == RMW_QOS_POLICY_RELIABILITY_UNKNOWN ||
      asked.durability == RMW_QOS_POLICY_DURABILITY_UNKNOWN ||
      asked.liveliness == RMW_QOS_POLICY_LIVELINESS_UNKNOWN) {
    RMW_SET_ERROR_MSG("the QoS has an unknown policy");
    return false;
  }
  if (resolved.history == RMW_QOS_POLICY_HISTORY_SYSTEM_DEFAULT)
    resolved.history = RMW_QOS_POLICY_HISTORY_KEEP_LAST;
  if (resolved.history == RMW_QOS_POLICY_HISTORY_KEEP_LAST && resolved.depth == 0)
    resolved.depth = 1;
  if (resolved.reliability == RMW_QOS_POLICY_RELIABILITY_SYSTEM_DEFAULT)
    resolved.reliability = RMW_QOS_POLICY_RELIABILITY_RELIABLE;
  if (resolved.durability == RMW_QOS_POLICY_DURABILITY_SYSTEM_DEFAULT)
    resolved.durability = RMW_QOS_POLICY_DURABILITY_VOLATILE;
  if (resolved.liveliness == RMW_QOS_POLICY_LIVELINESS_SYSTEM_DEFAULT)
    resolved.liveliness = RMW_QOS_POLICY_LIVELINESS_AUTOMATIC;
  for (rmw_time_t* const time :
       {&resolved.deadline, &resolved.lifespan, &resolved.liveliness_lease_duration}) {
    if (time->sec == 0 && time->nsec == 0) *time = RMW_DURATION_INFINITE;
  }
  return true;
}

}  // namespace agnocast::rmw

namespace {

/// What is known of one policy of both sides.
enum class Match { yes, perhaps, no };

/// For a policy with a weaker and a stronger value; any other value of a side may be either.
template <class Value>
Match match_of(Value offered, Value requested, Value weaker, Value stronger) noexcept {
  constexpr Value system_default{};  // the first of each policy: the same for both sides here
  if (requested == weaker || offered == stronger) return Match::yes;
  if (offered == system_default && requested == system_default) return Match::yes;
  return offered == weaker && requested == stronger ? Match::no : Match::perhaps;
}

/// For a time that may at most be as long as requested; zero and infinite are none.
Match match_of(const rmw_time_t& offered, const rmw_time_t& requested) noexcept {
  const auto is_none = [](const rmw_time_t& time) {
    return (time.sec == 0 && time.nsec == 0) || rmw_time_equal(time, RMW_DURATION_INFINITE);
  };
  if (is_none(requested)) return Match::yes;
  const bool is_enough =
      !is_none(offered) && rmw_time_total_nsec(offered) <= rmw_time_total_nsec(requested);
  return is_enough ? Match::yes : Match::no;
}

/// Collects what does not go together.
class Verdict {
 public:
  void add(Match match, const char* what) {
    if (match == Match::yes) return;
    text_ += std::string(match == Match::no ? "ERROR: " : "WARNING: ") + what + ";";
    const auto now =
        match == Match::no ? RMW_QOS_COMPATIBILITY_ERROR : RMW_QOS_COMPATIBILITY_WARNING;
    if (result_ != RMW_QOS_COMPATIBILITY_ERROR) result_ = now;
  }
  rmw_qos_compatibility_type_t result() const noexcept { return result_; }
  const std::string& text() const noexcept { return text_; }

 private:
  rmw_qos_compatibility_type_t result_ = RMW_QOS_COMPATIBILITY_OK;
  std::string text_;
};

}  // namespace

extern "C" {

rmw_ret_t rmw_qos_profile_check_compatible(const rmw_qos_profile_t publisher_profile,
                                           const rmw_qos_profile_t subscription_profile,
                                           rmw_qos_compatibility_type_t* compatibility,
                                           char* reason, size_t reason_size) {
  AGNOCAST_RMW_NOT_NULL(compatibility);
  if (reason == nullptr && reason_size != 0)
    return refuse(RMW_RET_INVALID_ARGUMENT, "there is a size, and no place for the reason");
  const rmw_qos_profile_t &offered = publisher_profile, &requested = subscription_profile;
  return guarded([&] {
    Verdict verdict;
    verdict.add(
        match_of(offered.reliability, requested.reliability, RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT,
                 RMW_QOS_POLICY_RELIABILITY_RELIABLE),
        "the publisher may be best effort, and the subscription reliable");
    verdict.add(
        match_of(offered.durability, requested.durability, RMW_QOS_POLICY_DURABILITY_VOLATILE,
                 RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL),
        "the publisher may be volatile, and the subscription transient local");
    verdict.add(match_of(offered.deadline, requested.deadline),
                "the publisher's deadline is longer than the subscription's");
    verdict.add(
        match_of(offered.liveliness, requested.liveliness, RMW_QOS_POLICY_LIVELINESS_AUTOMATIC,
                 RMW_QOS_POLICY_LIVELINESS_MANUAL_BY_TOPIC),
        "the publisher's liveliness may be automatic, and the subscription's by topic");
    verdict.add(match_of(offered.liveliness_lease_duration, requested.liveliness_lease_duration),
                "the publisher's lease is longer than the subscription's");
    *compatibility = verdict.result();
    if (reason_size != 0) reason[verdict.text().copy(reason, reason_size - 1)] = '\0';
    return rmw_ret_t{RMW_RET_OK};
  });
}

}  // extern "C"
