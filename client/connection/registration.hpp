// SPDX-License-Identifier: Apache-2.0
//
// Registration: what one session has from its daemon: the process's identity there, the arena,
// board and client region, and the connection. docs/control-plane.md, "Connection and identity".
//
//   find_daemon() ──▶ say_hello(): connected, welcomed, memory mapped ──▶ registered
//                        ▲   └──anything fails──▶ undo()
//   continue_from() ─────┘
//
//   registered ──the connection ends──▶ say_rejoin() ──the daemon knows it──▶ registered again
//              └──the daemon's store is lost, and the session is unused──▶ unmap_all()
//
// The connecting thread makes it. From then on the control thread owns it, except for the
// connection and the mappings, which stay in place until unmap_all().
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <client/connection/connection.hpp>
#include <client/heap/arena.hpp>
#include <client/heap/sparse_region.hpp>
#include <client/process/control_wake.hpp>

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <utility>

namespace agnocast {

class Registration {
 public:
  using Clock = std::chrono::steady_clock;

  // --- before the control thread begins

  /// Reads the daemon's place from the environment. Errors: invalid_argument (ROS_DOMAIN_ID).
  [[nodiscard]] Result<void> find_daemon();
  /// Uses the daemon at the same place. `former` must outlive say_hello().
  void continue_from(const Registration& former);
  /// Connects and maps, until `deadline`. `heap_is_open`: the contents of the previous arena have
  /// to stay in place. Errors: those of Context::connect. After a failure, undo() cleans up.
  [[nodiscard]] Result<void> say_hello(Clock::time_point deadline, bool heap_is_open);
  /// Returns whether a daemon accepted a connection since undo().
  bool has_connected() const noexcept { return connection_ != nullptr; }
  void undo() noexcept;

  // --- any thread, once it is registered

  const std::string& path() const noexcept { return path_; }
  Connection& connection() const noexcept { return *connection_; }
  /// Returns the wake of the control thread; null before the first say_hello().
  const std::shared_ptr<const ControlWake>& wake() const noexcept { return wake_; }
  std::function<void()> waker() const {
    return [wake = wake_] { (*wake)(); };
  }
  std::uint64_t incarnation() const noexcept { return incarnation_; }
  /// Client and generation.
  const std::pair<std::uint64_t, std::uint64_t>& client() const noexcept { return client_; }
  /// Returns the generation of the client that agnocastd welcomed last in this process; 0: none.
  static std::uint64_t last_client() noexcept;
  const Arena* arena() const noexcept { return arena_.get(); }
  SparseRegion& board() noexcept { return board_; }
  SparseRegion& region() noexcept { return region_; }
  std::byte* region_base() const noexcept { return region_.base(); }
  /// Maps the topic's entry on the board and the words of a new endpoint.
  [[nodiscard]] Result<void> open_extents(const abi::wire::EndpointCreated& made,
                                          std::uint64_t bytes);

  // --- control thread

  /// Connects to the daemon again, without waiting for room in its queue.
  [[nodiscard]] Result<void> connect_again();
  /// Sends the previous identity. The answer comes as an unasked packet.
  [[nodiscard]] Result<void> say_rejoin();
  /// Reports occupied address ranges, ahead of all requests: the daemon must not place windows
  /// there.
  void say_blocked();
  void unmap_all() noexcept;

 private:
  Result<void> map_regions(const abi::wire::Welcome& welcome, std::span<UniqueFd> fds,
                           bool heap_is_open);
  Result<void> reserve_arena(std::uint64_t base, std::uint64_t bytes, bool heap_is_open);

  const Registration* former_ = nullptr;
  // As found by the first registration.
  std::string path_, process_name_;
  std::uint64_t domain_ = 0;
  std::shared_ptr<const ControlWake> wake_;
  std::unique_ptr<Connection> connection_;
  std::shared_ptr<const Arena> arena_;  // may be shared with the previous session
  SparseRegion board_, region_;
  std::uint64_t incarnation_ = 0;
  std::pair<std::uint64_t, std::uint64_t> client_{};
};

}  // namespace agnocast
