// SPDX-License-Identifier: Apache-2.0
//
// AnswerPacket: one packet of a long answer to an observer, with several bodies, each behind its
// own header that gives its length (include/agnocast/abi/observe.hpp). The packet is input: call
// is_whole() before reading a body.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <base/sockets/packet_socket.hpp>

#include <array>
#include <cstddef>
#include <cstring>
#include <span>
#include <utility>

namespace agnocast {

class AnswerPacket {
 public:
  /// Returns the buffer to receive the next packet into.
  std::span<std::byte> buffer() noexcept { return bytes_; }
  /// Starts at the first body of a received packet. An empty Packet has none.
  void begin(Packet packet) noexcept {
    packet_ = std::move(packet);
    at_ = descriptors_taken_ = 0;
  }
  /// Moves behind the present body, which must be whole. Returns false if no body follows.
  bool advance() noexcept {
    if (at_ < packet_.bytes) at_ += header().bytes;
    return at_ < packet_.bytes;
  }
  /// Returns whether the present body is inside the packet.
  bool is_whole() const noexcept {
    if (packet_.bytes - at_ < sizeof(abi::wire::Header)) return false;
    return header().bytes >= sizeof(abi::wire::Header) && header().bytes <= packet_.bytes - at_;
  }
  abi::wire::Header header() const noexcept {
    abi::wire::Header header{};
    std::memcpy(&header, &bytes_[at_], sizeof header);
    return header;
  }
  /// Copies the present body to `body`. Returns false if its length differs.
  template <class Body>
  bool read(Body& body) const noexcept {
    if (header().bytes != sizeof body) return false;
    std::memcpy(static_cast<void*>(&body), &bytes_[at_], sizeof body);
    return true;
  }
  /// Returns the next descriptor of the packet; empty if there are no more.
  UniqueFd take_descriptor() noexcept {
    if (descriptors_taken_ == packet_.descriptor_count) return {};
    return std::move(packet_.descriptors[descriptors_taken_++]);
  }

 private:
  alignas(8) std::array<std::byte, abi::wire::answer_bytes_max> bytes_;
  Packet packet_;
  std::size_t at_ = 0, descriptors_taken_ = 0;
};

}  // namespace agnocast
