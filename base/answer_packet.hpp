// SPDX-License-Identifier: Apache-2.0
//
// AnswerPacket: one packet of what the daemon answers an observer at length: several bodies, each behind
// its own header and as long as that says (include/agnocast/abi/observe.hpp). Input: a body is looked at only
// after is_whole().
#pragma once

#include <agnocast/abi/observe.hpp>
#include <base/packet_socket.hpp>
#include <base/unique_fd.hpp>

#include <array>
#include <cstddef>
#include <cstring>
#include <span>
#include <utility>

namespace agnocast {

class AnswerPacket {
 public:
  /// Where the next packet is received into.
  std::span<std::byte> buffer() noexcept { return bytes_; }
  /// It is there; the present body is its first. An empty Packet: there is none.
  void begin(Packet packet) noexcept {
    packet_ = std::move(packet);
    at_ = descriptors_taken_ = 0;
  }
  /// On to the body behind the present one, which is_whole(). False: there is none.
  bool advance() noexcept {
    if (at_ < packet_.bytes) at_ += header().bytes;
    return at_ < packet_.bytes;
  }
  /// Whether the present body is inside the packet.
  bool is_whole() const noexcept {
    if (packet_.bytes - at_ < sizeof(abi::wire::Header)) return false;
    return header().bytes >= sizeof(abi::wire::Header) && header().bytes <= packet_.bytes - at_;
  }
  abi::wire::Header header() const noexcept {
    abi::wire::Header header{};
    std::memcpy(&header, &bytes_[at_], sizeof header);
    return header;
  }
  /// The present body as a T, if it is as long.
  template <class Body>
  bool read(Body& body) const noexcept {
    if (header().bytes != sizeof body) return false;
    std::memcpy(static_cast<void*>(&body), &bytes_[at_], sizeof body);
    return true;
  }
  /// The next descriptor of the packet; empty when it brought no more.
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
