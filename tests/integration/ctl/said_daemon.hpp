// SPDX-License-Identifier: Apache-2.0
//
// A socket of the test that answers as agnocastd does, whatever the test lets it say of callback
// groups and threads, with this process as the only client.
#pragma once

#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/wire/listen_at.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <gtest/gtest.h>

#include <poll.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::test {

using wire::Opcode;
using wire::ThreadCall;
using wire::ThreadSetting;

struct SaidThread : wire::DumpCallbackThread {
  std::vector<std::uint64_t> executors;  // in as many bodies as they need
};
/// What the daemon says.
struct Answers {
  wire::DumpDaemon daemon{};
  std::vector<wire::DumpProcess> processes;
  std::vector<wire::DumpUser> users;
  std::vector<wire::DumpCallbackGroup> groups;
  std::vector<SaidThread> threads;
  bool is_unasked = false;           // also to observers that do not ask for threads
  bool has_executors_first = false;  // before any thread
  wire::DumpEnd more_counted{};      // at the end, than were sent
};

/// Answers every observer, in a thread of its own.
class SaidDaemon {
 public:
  explicit SaidDaemon(Answers answers)
      : answers_(std::move(answers)),
        directory_(make_directory()),
        board_(::memfd_create("board", MFD_CLOEXEC)),
        listener_(listen_at(socket_path()).value()) {
    EXPECT_EQ(::ftruncate(board_.get(), static_cast<off_t>(abi::board_bytes)), 0);
    thread_ = std::thread([this] { serve(); });
  }
  ~SaidDaemon() {
    ends_ = true;
    thread_.join();
    remove_directory(directory_);
  }
  SaidDaemon(const SaidDaemon&) = delete;
  SaidDaemon& operator=(const SaidDaemon&) = delete;
  std::string socket_path() const { return directory_ + "/socket"; }

 private:
  void serve() {
    std::vector<PacketSocket> observers;
    while (!ends_) {
      std::vector<pollfd> all{{listener_.fd(), POLLIN, 0}};
      for (const PacketSocket& one : observers) all.push_back({one.fd(), POLLIN, 0});
      ::poll(all.data(), all.size(), 10);
      if (auto accepted = listener_.accept(); accepted && *accepted)
        observers.push_back(std::move(**accepted));
      std::erase_if(observers, [this](const PacketSocket& one) { return !answer(one); });
    }
  }
  bool answer(const PacketSocket& socket) const {
    alignas(8) std::array<std::byte, wire::packet_bytes_max> bytes{};
    const auto packet = socket.receive(bytes);
    if (!packet || packet->kind == Packet::Kind::end) return false;
    if (packet->kind == Packet::Kind::nothing) return true;
    wire::Header header{};
    std::memcpy(&header, bytes.data(), sizeof header);
    if (header.opcode == Opcode::observe) {
      wire::Observed observed{};
      observed.client_region_bytes = abi::page_bytes;
      const int board = board_.get();
      return send(socket, Opcode::observed, observed, {&board, 1});
    }
    if (header.opcode == Opcode::read_journal)
      return send(socket, Opcode::journal_end, wire::JournalEnd{});
    wire::Dump request{};
    if (header.opcode != Opcode::dump || packet->bytes != sizeof request) return false;
    std::memcpy(&request, bytes.data(), sizeof request);
    return dump(socket, request.with_threads != 0 || answers_.is_unasked);
  }
  bool dump(const PacketSocket& socket, bool with_threads) const {
    wire::DumpEnd end{};
    const auto each = [&](Opcode opcode, const auto& bodies, std::uint64_t& count) {
      for (const auto& body : bodies) send(socket, opcode, body);
      count = bodies.size();
    };
    send(socket, Opcode::dump_daemon, answers_.daemon);
    each(Opcode::dump_process, answers_.processes, end.process_count);
    each(Opcode::dump_user, answers_.users, end.user_count);
    if (with_threads) {
      each(Opcode::dump_callback_group, answers_.groups, end.callback_group_count);
      dump_threads(socket, end);
    }
    end.callback_group_count += answers_.more_counted.callback_group_count;
    end.callback_thread_count += answers_.more_counted.callback_thread_count;
    end.thread_executors_count += answers_.more_counted.thread_executors_count;
    return send(socket, Opcode::dump_end, end);
  }
  void dump_threads(const PacketSocket& socket, wire::DumpEnd& end) const {
    const auto say_executors = [&](std::span<const std::uint64_t> executors) {
      wire::DumpThreadExecutors body{};
      std::copy(executors.begin(), executors.end(), body.executor);
      send(socket, Opcode::dump_thread_executors, body);
      ++end.thread_executors_count;
    };
    if (answers_.has_executors_first) say_executors({});
    for (const SaidThread& thread : answers_.threads) {
      send(socket, Opcode::dump_callback_thread, wire::DumpCallbackThread(thread));
      ++end.callback_thread_count;
      for (std::span<const std::uint64_t> left(thread.executors); !left.empty();) {
        const auto some =
            left.first(std::min<std::size_t>(left.size(), wire::thread_executor_count_max));
        say_executors(some);
        left = left.subspan(some.size());
      }
    }
  }
  template <class Body>
  static bool send(const PacketSocket& socket, Opcode opcode, Body body,
                   std::span<const int> fds = {}) {
    body.header = {opcode, sizeof body, 1};
    for (;;) {
      const auto sent = socket.send(std::as_bytes(std::span(&body, 1)), fds);
      if (!sent || *sent != Sent::would_block) return sent && *sent == Sent::sent;
      pollfd writable{socket.fd(), POLLOUT, 0};  // or the observer is gone
      ::poll(&writable, 1, 1000);
    }
  }

  const Answers answers_;
  const std::string directory_;
  const UniqueFd board_;
  const PacketListener listener_;
  std::atomic<bool> ends_{false};
  std::thread thread_;
};

inline std::uint32_t own_thread() { return static_cast<std::uint32_t>(::syscall(SYS_gettid)); }

inline constexpr std::uint64_t client = 3, generation = 9;

inline wire::DumpCallbackGroup group(std::uint64_t executor, std::uint64_t number, const char* node,
                                     const char* name) {
  wire::DumpCallbackGroup body{};
  body.client = client;
  body.client_generation = generation;
  body.executor = executor;
  body.group = number;
  body.node = wire_name(node);
  body.name = wire_name(name);
  return body;
}
/// Returns a thread that spins so many executors, from 0 on.
inline SaidThread thread(std::uint32_t number, std::uint32_t executor_count = 1) {
  SaidThread body{};
  body.client = client;
  body.client_generation = generation;
  body.thread = number;
  body.executor_count = executor_count;
  for (std::uint32_t i = 0; i < executor_count; ++i) body.executors.push_back(i);
  return body;
}
inline SaidThread ruled(ThreadSetting setting) {
  SaidThread body = thread(own_thread());
  body.rule = 12;
  body.setting = setting;
  body.scheduling.sets_policy = 1;
  body.scheduling.policy = SCHED_FIFO;
  body.scheduling.priority = 50;
  return body;
}
inline SaidThread refused(ThreadCall call, int error) {
  SaidThread body = ruled(ThreadSetting::refused);
  body.call = call;
  body.os_errno = static_cast<std::uint32_t>(error);
  return body;
}

/// Returns the answers with this process as client.
inline Answers this_process() {
  Answers answers;
  answers.daemon.pid = static_cast<std::uint32_t>(::getpid());
  answers.daemon.uid = ::geteuid();
  wire::DumpProcess process{};
  process.client = client;
  process.generation = generation;
  process.pid = static_cast<std::uint32_t>(::getpid());
  process.uid = ::geteuid();
  process.state = wire::ProcessState::connected;
  process.name = wire_name("lidar");
  answers.processes.push_back(process);
  return answers;
}
inline std::string process_words() {
  return "lidar (pid " + std::to_string(::getpid()) + ", uid " + std::to_string(::geteuid()) + ")";
}

}  // namespace agnocast::test
