// SPDX-License-Identifier: Apache-2.0
//
// ProxyWithoutDescriptors: forwards all packets to and from a daemon, but none of their
// descriptors: like a security module that does not let a process receive them, on a kernel
// without one. (With a module the kernel also reports truncated control data; a free descriptor
// number distinguishes that from a lack of numbers.)
#pragma once

#include <base/sockets/packet_socket.hpp>
#include <tests/support/wire/listen_at.hpp>

#include <gtest/gtest.h>
#include <poll.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <span>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::test {

class ProxyWithoutDescriptors {
 public:
  ProxyWithoutDescriptors(const std::string& path, std::string daemon)
      : path_(path), daemon_(std::move(daemon)), listener_(listen_at(path)) {
    EXPECT_TRUE(listener_);
    if (listener_) thread_ = std::thread([this] { serve(); });
  }
  ~ProxyWithoutDescriptors() {
    ends_ = true;
    if (thread_.joinable()) thread_.join();
    ::unlink(path_.c_str());
  }
  ProxyWithoutDescriptors(const ProxyWithoutDescriptors&) = delete;
  ProxyWithoutDescriptors& operator=(const ProxyWithoutDescriptors&) = delete;

 private:
  using Pair = std::pair<PacketSocket, PacketSocket>;  // to the client, and to the daemon

  /// Returns false when either end has closed.
  static bool pass_on(const PacketSocket& from, const PacketSocket& to) {
    std::array<std::byte, abi::wire::answer_bytes_max> buffer;
    for (;;) {
      const auto packet = from.receive(buffer);
      if (!packet || packet->kind == Packet::Kind::end) return false;
      if (packet->kind == Packet::Kind::nothing) return true;
      const auto sent = to.send(std::span(buffer).first(packet->bytes), {}, Wait::yes);
      if (!sent || *sent != Sent::sent) return false;
    }
  }
  void serve() {
    std::vector<Pair> pairs;
    while (!ends_) {
      std::vector<pollfd> readable{{listener_->fd(), POLLIN, 0}};
      for (const Pair& pair : pairs) {
        readable.push_back({pair.first.fd(), POLLIN, 0});
        readable.push_back({pair.second.fd(), POLLIN, 0});
      }
      ::poll(readable.data(), readable.size(), 20);
      std::erase_if(pairs, [](const Pair& pair) {
        return !pass_on(pair.second, pair.first) || !pass_on(pair.first, pair.second);
      });
      auto client = listener_->accept();
      if (!client || !*client) continue;
      auto daemon = PacketSocket::connect(daemon_);
      if (daemon) pairs.emplace_back(std::move(**client), std::move(*daemon));
    }
  }

  std::string path_, daemon_;
  Result<PacketListener> listener_;
  std::atomic<bool> ends_{false};
  std::thread thread_;
};

}  // namespace agnocast::test
