// SPDX-License-Identifier: Apache-2.0
//
// Closing what somebody else has sent, for threads that may wait.
//
// A close may last as long as the sender likes: a TCP socket with SO_LINGER and unsent data waits for its peer,
// a file of FUSE for its server. A connection is no better: closing it closes what is queued in it.
//
// A thread that ends never lingers (the kernel looks at PF_EXITING). So close_by_ending_thread() has a thread
// take the descriptors over into a descriptor table of its own (pidfd_getfd of this very process) and end.
// What is queued in them never gets a number, so no flush() of a file system is called for it either. Where a
// filter forbids one of these calls they are closed as anybody would, and that may be long.
#pragma once

#include <base/unique_fd.hpp>

#include <span>

namespace agnocast {

/// Closes them at the end of a thread; returns when that has come, which may be never.
void close_by_ending_thread(std::span<UniqueFd> fds) noexcept;
/// Closes them here, after asking sockets not to linger.
void close_received(std::span<UniqueFd> fds) noexcept;

// --- for threads that may not wait
/// The same by a thread for whose end nobody waits.
void close_without_waiting(UniqueFd fd) noexcept;
/// Takes one datagram out of the socket, with whatever came with it, which such a thread closes. False: it did
/// not come to it soon, or too many of them are stuck.
bool throw_datagram_away(int socket) noexcept;

}  // namespace agnocast
