// SPDX-License-Identifier: Apache-2.0
//
// RawNode: a greeted raw client with board and region mapped, and helpers of the protocol tests.
#pragma once

#include <agnocast/abi/board.hpp>
#include <base/descriptors/doorbell.hpp>
#include <base/memory/mapping.hpp>
#include <base/memory/memory_policy.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <grp.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <functional>

namespace agnocast::test {

inline constexpr uid_t other_uid = 65534;
inline constexpr abi::Qos reliable{1, false, true, false, false};
inline constexpr abi::Qos best_effort{1, false, false, false, false};

inline Mapping map_region(const UniqueFd& fd, Mapping::Access access) {
  return std::move(Mapping::map(fd.get(), std::uint64_t{1} << 30, access).value());
}
inline std::uint64_t word(const Mapping& mapping, std::uint64_t offset) {
  return SharedMemory::word(mapping.base(), offset).load();
}
inline std::uint64_t publisher_word(const Mapping& board, std::uint32_t topic,
                                    std::uint64_t index) {
  return word(board, abi::topic_offset(topic) + abi::publisher_entry_offset(index));
}
inline std::uint64_t subscription_word(const Mapping& board, std::uint32_t topic,
                                       std::uint64_t index) {
  return word(board, abi::topic_offset(topic) +
                         abi::subscription_entry_offset(abi::publisher_count_max, index));
}

// Runs the body in a process of another user (as far as the test may); returns its result, unless
// an expectation failed there.
inline int in_other_user(const std::function<int()>& body) {
  const pid_t pid = ::fork();
  if (pid == 0) {
    if (::setgroups(0, nullptr) != 0 || ::setgid(other_uid) != 0 || ::setuid(other_uid) != 0)
      ::_exit(99);
    const int result = body();
    ::_exit(testing::Test::HasFailure() ? 98 : result);
  }
  int status = 0;
  ::waitpid(pid, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

/// A connected and greeted client with its board and region mapped.
struct RawNode {
  explicit RawNode(const DaemonProcess& daemon, std::uint64_t domain = 0)
      : wire(daemon.socket_path()) {
    Incoming answer = wire.hello(abi::fingerprint(), domain);
    if (answer.opcode() != wire::Opcode::welcome || answer.fds.size() != 2) {
      ADD_FAILURE() << "no welcome: " << answer.refused_text();
      return;
    }
    welcome = answer.as<wire::Welcome>();
    board = std::move(
        Mapping::map(answer.fds[0].get(), abi::board_bytes, Mapping::Access::read).value());
    region = map_region(answer.fds[1], Mapping::Access::read_write);
    fds = std::move(answer.fds);
  }
  wire::EndpointCreated created(const Incoming& answer) {
    EXPECT_EQ(answer.opcode(), wire::Opcode::endpoint_created) << answer.refused_text();
    return answer.opcode() == wire::Opcode::endpoint_created ? answer.as<wire::EndpointCreated>()
                                                             : wire::EndpointCreated{};
  }
  wire::EndpointCreated publisher(std::string_view topic, const abi::Qos& qos = reliable) {
    return created(wire.create_publisher(topic, qos));
  }
  wire::EndpointCreated subscription(std::string_view topic, const abi::Qos& qos = reliable) {
    if (!executor) {
      Incoming answer = wire.open_wait_set();
      EXPECT_EQ(answer.opcode(), wire::Opcode::wait_set_opened) << answer.refused_text();
      EXPECT_EQ(answer.fds.size(), 2u);
      if (answer.fds.size() == 2)
        doorbells = DoorbellReceiver(std::move(answer.fds[0]), std::move(answer.fds[1]));
      executor = true;
    }
    return created(wire.create_subscription(topic, qos));
  }

  WireClient wire;
  wire::Welcome welcome{};
  Mapping board, region;
  std::vector<UniqueFd> fds;
  DoorbellReceiver doorbells;
  bool executor = false;
};

}  // namespace agnocast::test
