// SPDX-License-Identifier: Apache-2.0
//
// OwnEndpoint: what a process knows of its own endpoints, by domain and name. DDS matches endpoints
// within a process at once, and nodes rely on it; here the threads of the library need a moment,
// for which a creation waits.
#pragma once

#include <agnocast/heap.hpp>

#include <sys/types.h>
#include <unistd.h>

#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

namespace agnocast::rmw {

/// None: that of the process.
using OwnDomain = std::optional<std::uint64_t>;

/// One endpoint, with a fact of it, while it lives. Any thread.
template <class Fact>
class OwnEndpoint {
 public:
  OwnEndpoint(OwnDomain domain, const std::string& name, Fact fact) {
    const LoanPause pause;  // the list is private memory
    Shared& shared = OwnEndpoint::shared();
    const std::lock_guard lock(shared.mutex);
    place_ = shared.all.emplace(Key(domain, name), std::move(fact));
  }
  ~OwnEndpoint() {
    if (::getpid() != process_)
      return;  // a forked child, where somebody may have the lock for ever
    Shared& shared = OwnEndpoint::shared();
    const std::lock_guard lock(shared.mutex);
    shared.all.erase(place_);
  }
  OwnEndpoint(const OwnEndpoint&) = delete;
  OwnEndpoint& operator=(const OwnEndpoint&) = delete;

  /// Calls `see(fact)` for each endpoint of a name; none of them ends meanwhile, so it must not
  /// wait. Not in a forked child.
  template <class See>
  static void visit(OwnDomain domain, const std::string& name, See see) {
    Shared& shared = OwnEndpoint::shared();
    const std::lock_guard lock(shared.mutex);
    const auto [begin, end] = shared.all.equal_range(Key(domain, name));
    for (auto one = begin; one != end; ++one) see(one->second);
  }

 private:
  using Key = std::pair<OwnDomain, std::string>;
  using All = std::multimap<Key, Fact>;
  struct Shared {
    std::mutex mutex;
    All all;
  };
  static Shared& shared() {
    static Shared* const only = new Shared;  // objects of static storage end after it
    return *only;
  }

  const pid_t process_ = ::getpid();
  typename All::iterator place_;
};

}  // namespace agnocast::rmw
