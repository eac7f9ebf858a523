// SPDX-License-Identifier: Apache-2.0
//
// Closing and using what others have a hand in, for threads that may wait.
//
// A close may last as long as the sender likes: a TCP socket with SO_LINGER and unsent data waits for its peer,
// a file of FUSE for its server, which not even SIGKILL ends. A connection is no better: closing it closes what is
// queued in it.
//
// So what others have sent is closed by a thread that ends, in a descriptor table of its own. A thread that ends
// never lingers (the kernel looks at PF_EXITING), and one that is stuck keeps nothing else open: neither a lock nor
// a connection, which would outlive a killed process with the table of its threads. The thread takes the
// descriptors over (pidfd_getfd of this very process) and ends; what is queued in them never gets a number, so no
// flush() of a file system is called for it either. Where a filter forbids one of these calls (EPERM, ENOSYS) they
// are closed as anybody would, and that may be long.
#pragma once

#include <base/packet_socket.hpp>
#include <base/unique_fd.hpp>

#include <sys/types.h>

#include <cstddef>
#include <functional>
#include <span>

namespace agnocast {

/// A thread that ends, with what it has taken over.
struct EndingThread {
  pid_t id = 0;   ///< 0: none was begun
  int error = 0;  ///< why it has not taken over everything
  /// No other try will do.
  bool is_forbidden() const noexcept;
};
/// Whether it has closed everything.
bool has_ended(pid_t thread) noexcept;

/// Hands them over to a thread that ends now; waits until it has them, and not for its end. What it could not take
/// over stays in `fds`.
EndingThread close_at_end_of_thread(std::span<UniqueFd> fds) noexcept;
/// Closes them at the end of a thread; returns when that has come, which may be never.
void close_by_ending_thread(std::span<UniqueFd> fds) noexcept;
/// Closes them here, after asking sockets not to linger.
void close_received(std::span<UniqueFd> fds) noexcept;

/// Uses a file that somebody else may write to, and so keep locked: calls `work` with a number of it in a thread
/// that has nothing else open, and waits for that, which may be for ever. Takes no number of the caller's. Where
/// such threads are forbidden or there is none left, it calls `work` here.
void use_in_own_table(int fd, const std::function<void(int)>& work) noexcept;

/// One packet, and of all that came with it the memory that was wanted.
struct ReceivedMemory {
  Result<Packet> packet;             ///< its descriptors are not in it
  std::size_t descriptor_count = 0;  ///< how many came
  UniqueFd memory;                   ///< the only one, and shared memory: closing it waits for nobody
  pid_t thread = 0;                  ///< closes the others; 0: nobody does any more
};
/// Takes one packet out of a connection in a thread that ends, and takes over the connection with it, which may be its last
/// descriptor. Never sleeps for the sender, unless threads that end are forbidden. Errors (`packet`): os_failure.
ReceivedMemory receive_memory(PacketSocket connection, std::span<std::byte> buffer) noexcept;

// --- for threads that may not wait
/// The same by a thread for whose end nobody waits.
void close_without_waiting(UniqueFd fd) noexcept;
/// Takes one datagram out of the socket, with whatever came with it, which such a thread closes. False: it did
/// not come to it soon, or too many of them are stuck.
bool throw_datagram_away(int socket) noexcept;

}  // namespace agnocast
