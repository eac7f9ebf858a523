// SPDX-License-Identifier: Apache-2.0
//
// GraphWatch: the endpoints of one domain of the host, and their observers. A thread
// of its own sleeps until there is something new (agnocast::Graph), and tells of it. A thread that
// asks for a snapshot looks as well: rcl asks for the endpoints that it has just made.
#pragma once

#include <agnocast/graph.hpp>

#include <sys/types.h>

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <unordered_map>

namespace agnocast::rmw {

class GraphWatch {
 public:
  /// Begins to watch. `changed` is called in the thread, after each change of the domain; it must
  /// not throw. Throws std::system_error.
  GraphWatch(std::uint64_t domain, std::function<void()> changed);
  ~GraphWatch();
  GraphWatch(const GraphWatch&) = delete;
  GraphWatch& operator=(const GraphWatch&) = delete;

  /// Returns the present state, with the endpoints of the domain. Until there is one it waits, but
  /// not longer than a second after the watch began; then it is empty.
  std::shared_ptr<const GraphSnapshot> now();

 private:
  void run() noexcept;
  /// Under the mutex, as the next one.
  void look();
  void take(GraphChanges changes);

  const std::uint64_t domain_;
  const std::function<void()> changed_;
  const pid_t process_;
  const std::chrono::steady_clock::time_point began_ = std::chrono::steady_clock::now();
  Graph graph_;
  std::mutex mutex_;
  std::condition_variable came_;
  std::unordered_map<std::uint64_t, EndpointInfo> endpoints_;  // by generation
  std::uint64_t incarnation_ = 0;                              // 0 before the first state
  std::shared_ptr<const GraphSnapshot> last_;                  // null: of an earlier state
  bool is_unreported_ = false;  // it has changed since `changed` was called
  bool is_over_ = false;
  std::thread thread_;
};

}  // namespace agnocast::rmw
