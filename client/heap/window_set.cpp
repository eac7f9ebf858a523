// SPDX-License-Identifier: Apache-2.0

#include <agnocast/residency.hpp>

#include <algorithm>

namespace agnocast {

bool WindowSet::add(std::uintptr_t begin, std::uintptr_t end) noexcept {
  if (begin >= end) return false;
  if (count_ == count_max) return false;
  if (count_ == 0 || windows_[count_ - 1].end <= begin) [[likely]] {
    windows_[count_++] = {begin, end};
    return true;
  }
  std::size_t at = 0;
  while (at < count_ && windows_[at].begin < begin) ++at;
  if (at > 0 && windows_[at - 1].end > begin) return false;
  if (at < count_ && windows_[at].begin < end) return false;
  std::copy_backward(windows_.begin() + at, windows_.begin() + count_,
                     windows_.begin() + count_ + 1);
  windows_[at] = {begin, end};
  ++count_;
  return true;
}

}  // namespace agnocast
