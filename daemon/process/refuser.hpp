// SPDX-License-Identifier: Apache-2.0
//
// Refuser: serves when the daemon cannot continue a previous run.
//
// Another build has left its tables, or they are damaged. The refuser touches nothing of them,
// every descriptor stays in the store, and each client gets the reason: `refused` with
// layout_mismatch or store_damaged to any request, but daemon_not_running to `rejoin`, which means
// try later. The build that made the tables can be started again and continues.
#pragma once

#include <base/sockets/packet_socket.hpp>
#include <base/text/log.hpp>
#include <daemon/transport/dispatcher.hpp>
#include <daemon/transport/disposal.hpp>

#include <cstdint>
#include <map>
#include <optional>
#include <string>

namespace agnocast::daemon {

class Refuser {
 public:
  /// `code` is for every client, `why` for people as well.
  Refuser(PacketListener listener, Dispatcher& dispatcher, Disposal& disposal, Log& log, Errc code,
          std::string why)
      : listener_(std::move(listener)),
        dispatcher_(dispatcher),
        disposal_(disposal),
        log_(log),
        code_(code),
        why_(std::move(why)) {}
  ~Refuser();
  Refuser(const Refuser&) = delete;
  Refuser& operator=(const Refuser&) = delete;

  /// Begins to listen. Errors: os_failure.
  [[nodiscard]] Result<void> start();
  /// Listens again when it is time; call it after at most due_ms() (-1: nothing is due).
  void tick();
  int due_ms() const noexcept;

 private:
  struct Caller {
    PacketSocket socket;
    Dispatcher::Token token = 0;
    std::uint32_t uid = 0;
  };
  using Callers = std::map<std::uint64_t, Caller>;
  void accept_all();
  void answer(std::uint64_t id);
  void drop(Callers::iterator caller);

  PacketListener listener_;
  Dispatcher& dispatcher_;
  Disposal& disposal_;
  Log& log_;
  Errc code_;
  std::string why_;
  Dispatcher::Token listening_ = 0;
  std::optional<std::uint64_t> listens_again_ms_;  // set while no descriptor is left
  Callers callers_;
  std::uint64_t last_caller_ = 0;
};

}  // namespace agnocast::daemon
