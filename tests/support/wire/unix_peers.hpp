// SPDX-License-Identifier: Apache-2.0
//
// Which process can ring which doorbell: the kernel's list of connected datagram sockets
// (sock_diag). A message that arrives proves nothing, since a wait set that nobody can ring polls
// by itself.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <linux/netlink.h>
#include <linux/rtnetlink.h>
#include <linux/sock_diag.h>
#include <linux/unix_diag.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <charconv>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <system_error>

namespace agnocast::test {

/// Returns the inodes of the sockets that a process has open.
inline std::set<std::uint32_t> sockets_of(pid_t pid) {
  std::set<std::uint32_t> inodes;
  std::error_code gone;  // a descriptor may be closed during the check
  constexpr std::string_view prefix = "socket:[";
  for (const auto& fd :
       std::filesystem::directory_iterator("/proc/" + std::to_string(pid) + "/fd", gone)) {
    const std::string target = std::filesystem::read_symlink(fd, gone).string();
    std::uint32_t inode = 0;
    if (target.rfind(prefix, 0) == 0 &&
        std::from_chars(target.data() + prefix.size(), target.data() + target.size(), inode).ec ==
            std::errc())
      inodes.insert(inode);
  }
  return inodes;
}

/// Returns, for each connected datagram socket of this network namespace, the inode of its
/// receiver. Nothing if the kernel has no such list (CONFIG_UNIX_DIAG).
inline std::optional<std::map<std::uint32_t, std::uint32_t>> datagram_peers() {
  std::map<std::uint32_t, std::uint32_t> peers;
  const UniqueFd netlink(::socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_SOCK_DIAG));
  struct {
    nlmsghdr header;
    unix_diag_req body;
  } request{};
  request.header = {sizeof request, SOCK_DIAG_BY_FAMILY, NLM_F_REQUEST | NLM_F_DUMP, 0, 0};
  request.body.sdiag_family = AF_UNIX;
  request.body.udiag_states = ~0u;
  request.body.udiag_show = UDIAG_SHOW_PEER;
  if (::send(netlink.get(), &request, sizeof request, 0) < 0) return std::nullopt;
  alignas(nlmsghdr) std::array<char, 32768> buffer;
  for (;;) {
    const ssize_t received = ::recv(netlink.get(), buffer.data(), buffer.size(), 0);
    if (received <= 0) return std::nullopt;
    for (const char* packet = buffer.data(); packet < buffer.data() + received;) {
      const auto* const message = reinterpret_cast<const nlmsghdr*>(packet);
      packet += NLMSG_ALIGN(message->nlmsg_len);
      if (message->nlmsg_type == NLMSG_DONE) return peers;
      if (message->nlmsg_type != SOCK_DIAG_BY_FAMILY) return std::nullopt;
      const auto* const socket = reinterpret_cast<const unix_diag_msg*>(message + 1);
      if (socket->udiag_type != SOCK_DGRAM) continue;
      const auto* const end = reinterpret_cast<const char*>(message) + message->nlmsg_len;
      for (const auto* at = reinterpret_cast<const char*>(socket + 1); at < end;) {
        const auto* const attribute = reinterpret_cast<const rtattr*>(at);
        if (attribute->rta_type == UNIX_DIAG_PEER)
          std::memcpy(&peers[socket->udiag_ino], attribute + 1, sizeof(std::uint32_t));
        at += RTA_ALIGN(attribute->rta_len);
      }
    }
  }
}

/// Returns the sockets of `to` that a datagram socket of `from` is connected to.
inline std::set<std::uint32_t> rung_by(pid_t from, pid_t to) {
  const std::set<std::uint32_t> senders = sockets_of(from), receivers = sockets_of(to);
  std::set<std::uint32_t> rung;
  const auto peers = datagram_peers();
  if (!peers) return rung;
  for (const auto& [sender, receiver] : *peers) {
    if (senders.count(sender) != 0 && receivers.count(receiver) != 0) rung.insert(receiver);
  }
  return rung;
}

}  // namespace agnocast::test
