// SPDX-License-Identifier: Apache-2.0
//
// RequestTable: which function of which class serves a request, by its kind.
//
// The opcodes of the wire and the kinds of Request are one to one, except for repeated requests. A
// request without an entry is a bug of the code that filled the table.
#pragma once

#include <base/check.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/request_reading.hpp>

#include <algorithm>
#include <array>
#include <cstddef>
#include <functional>
#include <span>
#include <type_traits>
#include <variant>

namespace agnocast::daemon {

class RequestTable {
 public:
  /// `fds`: descriptors that came with the packet; decode() has counted them.
  using Descriptors = std::span<UniqueFd>;

  /// The caller owns the handler, which must live as long as the table.
  template <class Handler, class Body>
  void add(Handler& handler, Result<void> (Handler::*function)(Peer&, const Body&)) {
    entries_[index_of<Body>()] = [&handler, function](Peer& peer, const Request& request,
                                                      Descriptors) {
      return (handler.*function)(peer, std::get<Body>(request));
    };
  }
  template <class Handler, class Body>
  void add(Handler& handler, Result<void> (Handler::*function)(Peer&, const Body&, Descriptors)) {
    entries_[index_of<Body>()] = [&handler, function](Peer& peer, const Request& request,
                                                      Descriptors fds) {
      return (handler.*function)(peer, std::get<Body>(request), fds);
    };
  }
  /// Returns whether every kind of request has a handler.
  bool is_complete() const noexcept {
    return std::all_of(entries_.begin(), entries_.end(),
                       [](const Entry& entry) { return static_cast<bool>(entry); });
  }
  [[nodiscard]] Result<void> serve(Peer& peer, const Request& request, Descriptors fds) const {
    const Entry& entry = entries_[request.index()];
    AGNOCAST_CHECK(entry);
    return entry(peer, request, fds);
  }

 private:
  using Entry = std::function<Result<void>(Peer&, const Request&, Descriptors)>;

  template <class Body, std::size_t index = 0>
  static constexpr std::size_t index_of() noexcept {
    if constexpr (std::is_same_v<Body, std::variant_alternative_t<index, Request>>)
      return index;
    else
      return index_of<Body, index + 1>();
  }

  std::array<Entry, std::variant_size_v<Request>> entries_;
};

}  // namespace agnocast::daemon
