// SPDX-License-Identifier: Apache-2.0
//
// Helpers of the tests of the daemon's restart: processes that exchange messages and must not be
// disturbed, ways to keep the daemon away, and orders to its supervisor.
#pragma once

#include <base/descriptors/pidfd.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <tests/recovery/stage.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/wire/wire_node.hpp>

#include <gtest/gtest.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <sstream>
#include <string>

namespace agnocast::test {

inline constexpr abi::Qos deep{10, false, true, false, false};
inline constexpr const char* topic_name = "/restart";

using sweep::answer;

// A publisher in a process of its own, because no two clients of one process could have the same
// window: w until a subscription is attached · p publish.
inline sweep::Child publisher_child(const std::string& socket, const char* topic = topic_name) {
  return sweep::Child(0, [socket, topic](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket);
    if (!node.create_publisher(topic, deep)) ::_exit(3);
    std::uint64_t number = 0;
    sweep::serve(commands, [&](char what) -> char {
      if (what == 'w') return answer(node.wait_for([&] { return node.attached_count() == 1; }));
      return answer(node.publish(++number));
    });
  });
}
// w until a publisher is linked · t take the next, which must be the successor of the last.
inline sweep::Child subscriber_child(const std::string& socket, const char* topic = topic_name) {
  return sweep::Child(0, [socket, topic](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(socket);
    if (!node.create_subscription(topic, deep)) ::_exit(3);
    std::uint64_t last = 0;
    sweep::serve(commands, [&](char what) -> char {
      if (what == 'w') return answer(node.wait_for([&] { return node.link_count() == 1; }));
      const auto number = node.take();
      const bool next = number && (last == 0 || *number == last + 1);
      last = number.value_or(0);
      return answer(next && node.release());
    });
  });
}
// Two processes that exchange messages; nothing must disturb them.
struct Pair {
  explicit Pair(DaemonProcess& daemon, const char* topic = topic_name)
      : publisher(publisher_child(daemon.socket_path(), topic)),
        subscriber(subscriber_child(daemon.socket_path(), topic)) {
    EXPECT_EQ(publisher.command('w'), '+');
    EXPECT_EQ(subscriber.command('w'), '+');
  }
  void exchange() {
    EXPECT_EQ(publisher.command('p'), '+');
    EXPECT_EQ(subscriber.command('t'), '+');
  }
  sweep::Child publisher, subscriber;
};

// Keeps the daemon away until destroyed.
class Absence {
 public:
  explicit Absence(DaemonProcess& daemon) : daemon_(daemon), old_(daemon.pid()) {
    const auto worker = Pidfd::open(old_);
    ::kill(daemon.supervisor_pid(), SIGSTOP);
    daemon.kill_worker();
    pollfd entry{worker->fd(), POLLIN, 0};
    EXPECT_EQ(::poll(&entry, 1, WireClient::patience_ms), 1);
  }
  ~Absence() {
    ::kill(daemon_.supervisor_pid(), SIGCONT);
    EXPECT_TRUE(daemon_.wait_for_next(old_));
  }
  Absence(const Absence&) = delete;
  Absence& operator=(const Absence&) = delete;

 private:
  DaemonProcess& daemon_;
  pid_t old_;
};

inline void restart(DaemonProcess& daemon, bool politely = false) {
  const pid_t old = daemon.pid();
  if (politely) {
    ::kill(daemon.supervisor_pid(), SIGHUP);
  } else {
    daemon.kill_worker();
  }
  ASSERT_TRUE(daemon.wait_for_next(old)) << daemon.log();
}

// Returns the worker's address of the supervisor, seen from here.
inline sockaddr_un address_of_supervisor(const DaemonProcess& daemon) {
  std::ifstream file("/proc/" + std::to_string(daemon.pid()) + "/environ", std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  const std::string environment = text.str();
  const std::string prefix = "NOTIFY_SOCKET=/proc/self/fd/";
  const std::size_t at = environment.find(prefix);
  EXPECT_NE(at, std::string::npos);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (at != std::string::npos)
    std::snprintf(address.sun_path, sizeof address.sun_path, "/proc/%d/fd/%s",
                  static_cast<int>(daemon.pid()), environment.c_str() + at + prefix.size());
  return address;
}

/// Sends an order to the supervisor in the name of its worker. Needs root.
inline void order_as_worker(const DaemonProcess& daemon, const std::string& order) {
  sockaddr_un address = address_of_supervisor(daemon);
  const UniqueFd socket(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  iovec data{const_cast<char*>(order.data()), order.size()};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(ucred))] = {};
  msghdr message{};
  message.msg_name = &address;
  message.msg_namelen = sizeof address;
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  cmsghdr* const part = CMSG_FIRSTHDR(&message);
  part->cmsg_level = SOL_SOCKET;
  part->cmsg_type = SCM_CREDENTIALS;
  part->cmsg_len = CMSG_LEN(sizeof(ucred));
  const ucred worker{daemon.pid(), ::getuid(), ::getgid()};
  std::memcpy(CMSG_DATA(part), &worker, sizeof worker);
  ASSERT_EQ(::sendmsg(socket.get(), &message, 0), static_cast<ssize_t>(order.size()))
      << std::strerror(errno);
}

}  // namespace agnocast::test
