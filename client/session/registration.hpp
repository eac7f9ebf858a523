// SPDX-License-Identifier: Apache-2.0
//
// Registration: what one session has from its daemon: who this process is to it, the arena, board
// and client region, and the connection. docs/control-plane.md, "Connection and identity".
//
//   find_daemon() ──▶ say_hello(): connected, welcomed; arena reserved, board and region mapped ──▶ registered
//                        ▲   └──anything fails──▶ undo()
//   continue_from() ─────┘
//
//   registered ──the connection ends──▶ say_rejoin() ──the daemon knows it──▶ registered, over another connection
//              └──the daemon's store is lost, nobody uses it──▶ unmap_all()
//
// Made by the thread that connects; from then on the control thread's, but for the connection and
// for what is mapped, which stays where it is until unmap_all().
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <client/heap/arena.hpp>
#include <client/heap/sparse_region.hpp>
#include <client/process/control_wake.hpp>
#include <client/session/connection.hpp>

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

  /// What the environment says of it. Errors: invalid_argument (ROS_DOMAIN_ID).
  [[nodiscard]] Result<void> find_daemon();
  /// The daemon at the same place, beside a registration that must outlive say_hello().
  void continue_from(const Registration& former);
  /// Until `deadline`. `heap_is_open`: what lies in the former one's arena has to stay there.
  /// Errors: those of Context::connect. Leaves what it has done for undo().
  [[nodiscard]] Result<void> say_hello(Clock::time_point deadline, bool heap_is_open);
  /// There was a daemon, whatever it said: since undo().
  bool has_connected() const noexcept { return connection_ != nullptr; }
  void undo() noexcept;

  // --- any thread, once it is registered

  const std::string& path() const noexcept { return path_; }
  Connection& connection() const noexcept { return *connection_; }
  /// Of the control thread; null before the first say_hello().
  const std::shared_ptr<const ControlWake>& wake() const noexcept { return wake_; }
  std::function<void()> waker() const {
    return [wake = wake_] { (*wake)(); };
  }
  std::uint64_t incarnation() const noexcept { return incarnation_; }
  /// Client and generation.
  const std::pair<std::uint64_t, std::uint64_t>& client() const noexcept { return client_; }
  const Arena* arena() const noexcept { return arena_.get(); }
  SparseRegion& board() noexcept { return board_; }
  SparseRegion& region() noexcept { return region_; }
  std::byte* region_base() const noexcept { return region_.base(); }
  /// The topic's entry on the board, and the words of a new endpoint.
  [[nodiscard]] Result<void> open_extents(const abi::wire::EndpointCreated& made,
                                          std::uint64_t bytes);

  // --- control thread

  /// A socket to the daemon, which does not wait for room in its queue.
  [[nodiscard]] Result<void> connect_again();
  /// Says who this was. Its answer comes unasked.
  [[nodiscard]] Result<void> say_rejoin();
  /// Ahead of all requests on a connection: what the daemon gives must not lie there.
  void say_blocked();
  void unmap_all() noexcept;

 private:
  Result<void> map_regions(const abi::wire::Welcome& welcome, std::span<UniqueFd> fds,
                           bool heap_is_open);
  Result<void> reserve_arena(std::uint64_t base, std::uint64_t bytes, bool heap_is_open);

  const Registration* former_ = nullptr;
  // As found by the first one.
  std::string path_, process_name_;
  std::uint64_t domain_ = 0;
  std::shared_ptr<const ControlWake> wake_;
  std::unique_ptr<Connection> connection_;
  std::shared_ptr<const Arena> arena_;  // several may have the same
  SparseRegion board_, region_;
  std::uint64_t incarnation_ = 0;
  std::pair<std::uint64_t, std::uint64_t> client_{};
};

}  // namespace agnocast
