// SPDX-License-Identifier: Apache-2.0
//
// Closing and using descriptors that other processes sent, from threads that may wait.
//
// The sender can make a close last as long as it likes: a TCP socket with SO_LINGER and unsent
// data waits for its peer, a file of FUSE for its server, and not even SIGKILL ends that. A
// connection is no better: closing it closes the descriptors queued in it.
//
// So a thread with a descriptor table of its own takes these descriptors over (pidfd_getfd of
// this very process) and ends. A thread that ends never lingers (the kernel looks at PF_EXITING),
// and if it is stuck, it keeps nothing else open: neither a lock nor a connection, which would
// outlive a killed process with the table of its threads. Descriptors queued in a closed
// connection never get a number, so no flush() of a file system is called for them either. Where
// a filter forbids one of these calls (EPERM, ENOSYS), the caller closes them as usual, which may
// take long.
#pragma once

#include <base/descriptors/unique_fd.hpp>
#include <base/sockets/packet_socket.hpp>

#include <sys/types.h>

#include <cstddef>
#include <functional>
#include <span>

namespace agnocast {

/// An ended or ending thread, with the descriptors that it took over.
struct EndingThread {
  pid_t id = 0;   ///< 0: none was started
  int error = 0;  ///< why it has not taken over all
  /// Returns whether further attempts will fail as well.
  bool is_forbidden() const noexcept;
};
/// Returns whether the thread has ended, so closed everything.
bool has_ended(pid_t thread) noexcept;

/// Passes descriptors to a new thread that ends at once; waits until it has them, but not for its
/// end. Descriptors that it could not take over stay in `fds`.
EndingThread close_at_end_of_thread(std::span<UniqueFd> fds) noexcept;
/// Closes them at the end of a thread; returns after that, which may be never.
void close_by_ending_thread(std::span<UniqueFd> fds) noexcept;
/// Closes them here, after switching off lingering of sockets.
void close_received(std::span<UniqueFd> fds) noexcept;

/// Uses a file that another process may write to, and so keep locked: calls `work` with its
/// number in a thread that has nothing else open, and waits for the return, possibly for ever.
/// Takes no number of the caller's table. If such threads are forbidden or cannot be made, it
/// calls `work` here.
void use_in_own_table(int fd, const std::function<void(int)>& work) noexcept;

/// One packet, and the expected memory from its descriptors.
struct ReceivedMemory {
  Result<Packet> packet;             ///< without its descriptors
  std::size_t descriptor_count = 0;  ///< received
  UniqueFd memory;                   ///< the only one, and shared memory: closing never waits
  pid_t thread = 0;                  ///< closes the others; 0: none is left to close
};
/// Receives one packet in a thread that ends, and takes over the connection, of which it may be
/// the last descriptor. Never waits for the sender, unless threads that end are forbidden. Errors
/// (`packet`): os_failure.
ReceivedMemory receive_memory(PacketSocket connection, std::span<std::byte> buffer) noexcept;

// --- for threads that may not wait
/// Closes it in a thread for whose end no caller waits.
void close_without_waiting(UniqueFd fd) noexcept;
/// Receives one datagram with all its descriptors, which such a thread closes. Returns false if
/// that took too long, or too many such threads are stuck.
bool throw_datagram_away(int socket) noexcept;

}  // namespace agnocast
