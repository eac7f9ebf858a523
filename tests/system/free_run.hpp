// SPDX-License-Identifier: Apache-2.0
//
// Free runs: publishers and subscribers run at full speed, and a reader judges whether its
// messages were allowed:
//   - per publisher the numbers grow: first in, first out, nothing twice;
//   - each message equals, member by member, the content that its name determines;
//   - each number left out is counted as lost, and nothing else is (with several publishers:
//     in the end, by the harness: taken and lost together are the committed ones);
//   - a loss was justified: whenever a message was lost at a take, the subscription's whole depth
//     of newer ones is committed, so the following depth-1 takes return messages.
// The last rule is stricter than "no more lost than committed" and needs no clock.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <map>
#include <string>

namespace agnocast::test {

/// Shared by harness and processes: survives the death of any of them.
struct Progress {
  static constexpr std::size_t publisher_count_max = 64;
  struct Publisher {
    std::atomic<std::uint64_t> attempted;  // before publish is called
    std::atomic<std::uint64_t> committed;  // after it returned
  };
  std::atomic<std::uint64_t> stop;
  Publisher publisher[publisher_count_max];

  static Progress& at(const std::string& path) {
    const UniqueFd file(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
    if (!file || ::ftruncate(file.get(), sizeof(Progress)) != 0) std::abort();
    void* const memory =
        ::mmap(nullptr, sizeof(Progress), PROT_READ | PROT_WRITE, MAP_SHARED, file.get(), 0);
    if (memory == MAP_FAILED) std::abort();
    return *static_cast<Progress*>(memory);
  }
};

/// The history of one subscription. It keeps the first complaint.
class FreeRunJudge {
 public:
  /// `publishers`: the total number of publishers, if the subscription was there before all of
  /// them (so number 1 is the first it wants); else 0.
  FreeRunJudge(std::uint64_t depth, std::uint64_t publishers)
      : depth_(depth), since_start_(publishers != 0), is_exact_(publishers == 1) {}

  void took(std::uint64_t publisher, std::uint64_t number, std::uint64_t lost, bool intact) {
    ++taken_;
    const auto [found, first] = last_.try_emplace(publisher, since_start_ ? 0 : number - 1);
    std::uint64_t& last = found->second;
    const std::string what = " (publisher " + std::to_string(publisher) + ", number " +
                             std::to_string(number) + " after " + std::to_string(last) + ")";
    if (!intact) complain("content differs" + what);
    if (number <= last) complain("out of order or twice" + what);
    gaps_ += number - last - 1;
    last = number;
    if (lost < lost_) complain("the lost counter went back" + what);
    // With several publishers, a loss of one is counted before its next message shows the gap.
    if (since_start_ && lost < gaps_) complain("a gap that is not counted" + what);
    if (is_exact_ && lost > gaps_) complain("counted as lost and not missing" + what);
    if (lost > lost_) {
      promised_ = depth_ - 1;  // this message is one of the newer ones
    } else if (promised_ > 0) {
      --promised_;
    }
    lost_ = lost;
  }
  void found_nothing() {
    if (promised_ > 0)
      complain("lost, but " + std::to_string(promised_) + " fewer newer messages than its depth");
  }
  /// "ok TAKEN LOST PUBLISHER:LAST…" or "bad WHY".
  std::string verdict() const {
    if (!complaint_.empty()) return "bad " + complaint_;
    std::string text = "ok " + std::to_string(taken_) + " " + std::to_string(lost_);
    for (const auto& [publisher, number] : last_)
      text += " " + std::to_string(publisher) + ":" + std::to_string(number);
    return text;
  }

 private:
  void complain(const std::string& what) {
    if (complaint_.empty()) complaint_ = what;
  }
  std::uint64_t depth_;
  bool since_start_, is_exact_;
  std::uint64_t taken_ = 0, lost_ = 0, gaps_ = 0, promised_ = 0;
  std::map<std::uint64_t, std::uint64_t> last_;
  std::string complaint_;
};

}  // namespace agnocast::test
