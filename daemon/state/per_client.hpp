// SPDX-License-Identifier: Apache-2.0
//
// PerClient: one value for each place that a process may take. A value is made when it is first
// written: a daemon seldom has more than a few of its 2,048 processes.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <base/check.hpp>
#include <daemon/state/tables.hpp>

#include <deque>

namespace agnocast::daemon {

template <class T>
class PerClient {
 public:
  /// References stay valid until clear(). Allocates for places that were not used before.
  T& operator[](ClientIndex client) {
    AGNOCAST_CHECK(number(client) < abi::client_count_max);
    while (values_.size() <= number(client)) values_.emplace_back();
    return values_[number(client)];
  }
  /// Returns an empty value for a place that was not used.
  const T& operator[](ClientIndex client) const {
    static const T unused{};
    return number(client) < values_.size() ? values_[number(client)] : unused;
  }
  void clear() noexcept { values_.clear(); }
  auto begin() const noexcept { return values_.begin(); }
  auto end() const noexcept { return values_.end(); }

 private:
  std::deque<T> values_;
};

}  // namespace agnocast::daemon
