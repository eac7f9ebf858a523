// SPDX-License-Identifier: Apache-2.0

#include <agnocastlib/failure_log.hpp>

#include <rclcpp/logging.hpp>

#include <chrono>
#include <string>

namespace agnocastlib {
namespace {

constexpr std::int64_t pause_ns = 1'000'000'000;

std::int64_t now_ns() noexcept {
  return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

bool FailureLog::is_due(std::uint64_t& silent) noexcept {
  const std::int64_t now = now_ns();
  std::int64_t next = next_ns_.load(std::memory_order_relaxed);
  // One of several threads writes.
  if (now < next ||
      !next_ns_.compare_exchange_strong(next, now + pause_ns, std::memory_order_relaxed)) {
    silent_.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  silent = silent_.exchange(0, std::memory_order_relaxed);
  return true;
}

void FailureLog::report(agnocast::Errc code) noexcept { report(agnocast::Failure{code, 0, "", 0}); }

void FailureLog::report(const agnocast::Failure& failure) noexcept {
  if (is_forked_child()) return;
  std::uint64_t silent = 0;
  if (!is_due(silent)) return;
  const agnocast::LoanPause pause;  // what logging allocates is private
  try {
    const std::string before =
        silent == 0 ? "" : " (" + std::to_string(silent) + " more since the last line)";
    const std::string detail = agnocast::detail_of(failure);
    RCLCPP_ERROR(logger_, "%s failed: %s: %s%s%s. To correct it: %s%s", what_.c_str(),
                 agnocast::word_of(failure.code), agnocast::sentence_of(failure.code),
                 detail.empty() ? "" : ": ", detail.c_str(), agnocast::remedy_of(failure.code),
                 before.c_str());
  } catch (...) {
    // There is no memory even for a line.
  }
}

}  // namespace agnocastlib
