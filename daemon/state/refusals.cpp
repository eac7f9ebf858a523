// SPDX-License-Identifier: Apache-2.0

#include <daemon/state/refusals.hpp>

#include <algorithm>
#include <map>
#include <utility>

namespace agnocast::daemon {

void Refusals::add(Refusal refusal) {
  const auto again = std::find_if(all_.begin(), all_.end(), [&](const Refusal& known) {
    return known.code == refusal.code && known.uid == refusal.uid && known.pid == refusal.pid &&
           known.domain == refusal.domain && known.kind == refusal.kind &&
           known.topic == refusal.topic;
  });
  if (again != all_.end()) {
    refusal.times += again->times;
    all_.erase(again);
  } else if (all_.size() == count_max) {
    std::map<std::uint32_t, std::size_t> of_user;
    for (const Refusal& known : all_) ++of_user[known.uid];
    const auto most =
        std::max_element(of_user.begin(), of_user.end(),
                         [](const auto& a, const auto& b) { return a.second < b.second; });
    all_.erase(std::find_if(all_.begin(), all_.end(),
                            [&](const Refusal& known) { return known.uid == most->first; }));
  }
  all_.push_back(std::move(refusal));
}

}  // namespace agnocast::daemon
