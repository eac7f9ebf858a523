// SPDX-License-Identifier: Apache-2.0
//
// Errors as values. One table holds every code with its sentence, its usual cause and its remedy;
// error texts, agnocast-ctl explain, documentation and tests are generated from it, so each code
// exists exactly once.
#pragma once

#include <agnocast/export.hpp>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <system_error>

namespace agnocast {

// AGNOCAST_ERROR_TABLE(X): X(enumerator, sentence, cause, remedy). Append codes, never renumber
// them: they are part of the wire protocol.
// clang-format off
#define AGNOCAST_ERROR_TABLE(X)                                                                                                                \
  X(os_failure, "the operating system refused an operation",                                                                                   \
    "a call failed in a way that agnocast does not expect: memory or descriptors are short, or a sandbox forbids the call",                    \
    "see the errno beside it")                                                                                                                 \
  X(internal, "an invariant of agnocast itself is broken; the endpoint is out of service",                                                     \
    "a fault of agnocast, or something in the process has overwritten its memory",                                                             \
    "report it")                                                                                                                               \
  X(protocol_violation, "a peer wrote something that the protocol does not allow",                                                             \
    "the two programs are not of the same build, or the other one is faulty or hostile",                                                       \
    "check the peer's version")                                                                                                                \
  X(no_slot, "every message slot of this publisher is in use",                                                                                 \
    "subscriptions hold or have not read as many messages as the publisher has slots",                                                         \
    "let subscriptions release messages, or raise their hold quota")                                                                           \
  X(would_block, "a keep-all subscription has not read enough yet",                                                                            \
    "the reader is slower than the publisher, and keep-all promises that nothing is dropped",                                                  \
    "publish later, or use a deeper history")                                                                                                  \
  X(heap_exhausted, "the shared heap of this process has no room for the message",                                                             \
    "messages that are held, unread or in the history fill the windows, and no further one is ready yet",                                      \
    "release messages, or raise [heap] window_bytes or [quota] heap_bytes in agnocastd.toml")                                                  \
  X(invalid_argument, "an argument is outside its domain",                                                                                     \
    "a value that was passed, or a variable of the environment, cannot be used",                                                               \
    "see what is named beside it")                                                                                                             \
  X(type_refused, "this type cannot be shared between processes",                                                                              \
    "it has parts that mean something in one process only (virtual functions, rosidl::Buffer), or its description contradicts it",             \
    "see docs/messages.md for what can")                                                                                                       \
  X(user_code_threw, "a constructor of the message threw an exception",                                                                        \
    "the message was built outside the shared heap, and the constructor that was to copy it in threw",                                         \
    "let it throw nothing but bad_alloc")                                                                                                      \
  X(daemon_not_running, "agnocastd does not answer",                                                                                           \
    "it was not started, or it listens at another socket than the one that is named",                                                          \
    "start it: systemctl start agnocastd; or name its socket in AGNOCAST_SOCKET")                                                              \
  X(permission_denied, "this user may not do that",                                                                                            \
    "the socket's mode and group do not let this user in, or what it asks for is another user's",                                              \
    "ask the administrator to be let in: into the group of the socket, see agnocast-ctl doctor")                                               \
  X(layout_mismatch, "library and daemon disagree about the layout of shared memory",                                                          \
    "they were built from different versions, or one of them was not restarted after an update",                                               \
    "use both from the same version, and restart agnocastd and the process")                                                                   \
  X(type_mismatch, "the topic has another message type, or the same type with another layout",                                                 \
    "another process was first on the topic with another type, or was built with other flags or from another version of the message",          \
    "use the type that agnocast-ctl topic info names, built with the same compiler and library")                                               \
  X(invalid_name, "a name is not a ROS 2 name",                                                                                                \
    "it is empty, too long, or has a character that ROS 2 does not allow in names",                                                            \
    "see the position named beside it")                                                                                                        \
  X(depth_refused, "the history depth is outside what the daemon allows",                                                                      \
    "the depth is 0, or above [limits] depth_max",                                                                                             \
    "use a smaller depth, or raise [limits] depth_max in agnocastd.toml")                                                                      \
  X(quota_exceeded, "a limit of this user or of the daemon is reached",                                                                        \
    "the processes of this user together have as much as [quota] or the daemon allows one user",                                               \
    "close what is not needed, or raise the limit that is named beside it in agnocastd.toml")                                                  \
  X(arena_occupied, "something in this process lies where the shared heaps have to lie",                                                       \
    "a library has reserved these addresses, or address randomisation has put something there",                                                \
    "move it, or set [heap] arena_base in agnocastd.toml")                                                                                     \
  X(lock_limit, "the limit of locked memory is too small",                                                                                     \
    "the process locks its memory (mlockall), and RLIMIT_MEMLOCK has no room for what the shared heap uses",                                   \
    "set LimitMEMLOCK=infinity in a drop-in of the unit (systemctl edit) or raise ulimit -l")                                                  \
  X(hook_missing, "the heap hook is not loaded in this process",                                                                               \
    "without libagnocast_heaphook.so only ROS messages and trivially copyable ones are published, by copy; or the hook has another version",   \
    "start the process with agnocast-run, or link libagnocast_heaphook")                                                                       \
  X(hook_ineffective, "memory is not allocated by the heap hook although it is loaded",                                                        \
    "another allocator is linked or preloaded in front of the hook, and answers malloc or operator new instead of it",                         \
    "remove the allocator that is named beside it, load the hook before it, or load no hook: messages are then copied")                                                          \
  X(window_exhausted, "this process has all heap windows it may have and they are full",                                                       \
    "messages that are held, unread or in the history fill all windows that one process may have",                                             \
    "release messages, or raise [heap] window_bytes or windows_per_process in agnocastd.toml")                                                 \
  X(bad_configuration, "the configuration of agnocastd cannot be used",                                                                        \
    "agnocastd.toml has an unknown key, a value of the wrong kind, or values that contradict each other",                                      \
    "correct the line that is named beside it; agnocastd --check-config checks it")                                                            \
  X(already_running, "another agnocastd has this socket",                                                                                      \
    "a daemon is running there already, for example the one that systemd has started",                                                         \
    "stop it, or start this one with another --socket")                                                                                        \
  X(endpoint_gone, "the other side has ended",                                                                                                 \
    "it was destroyed, or its process has ended, in the meantime",                                                                             \
    "create it again if it is still needed")                                                                                                   \
  X(loan_invalid, "this is no open loan of this publisher",                                                                                    \
    "the message was published, moved from, or borrowed from another publisher",                                                               \
    "publish a loan once, with the publisher that lent it; borrow a new one for each message")                                                 \
  X(qos_incompatible, "publisher and subscription want different qualities of service",                                                        \
    "the publisher offers less than the subscription asks for, best effort instead of reliable for example, or a longer deadline",             \
    "offer at least what is requested: reliability, durability, deadline and liveliness")                                                      \
  X(limit_reached, "a table of the daemon is full",                                                                                            \
    "all users together have as many of these as [limits] or the memory layout allows",                                                        \
    "close what is not needed; the table is named beside it")                                                                                  \
  X(shut_down, "the library does not serve this process any more",                                                                             \
    "it is a child of fork without exec, or exit handlers have begun",                                                                         \
    "call exec after fork, and create endpoints before exit handlers run")                                                                     \
  X(address_limit, "the limit of addresses is too small for the shared heaps",                                                                 \
    "RLIMIT_AS (ulimit -v, LimitAS) is smaller than the arena and what the process needs besides",                                             \
    "raise LimitAS of the unit or ulimit -v, or make [heap] arena_bytes smaller")                                                              \
  X(switched_off, "agnocast is switched off in this process",                                                                                  \
    "AGNOCAST=off was in its environment as the endpoint was created",                                                                         \
    "start it without AGNOCAST=off")                                                                                                           \
  X(started_anew, "agnocastd was started anew and does not know this process any more",                                                        \
    "the daemon was stopped and started, or what it keeps across restarts was lost",                                                           \
    "nothing: the library goes to it by itself; if that lasts, see orphan_reason and its log")                                                 \
  X(revoked, "the session of this process was ended from outside",                                                                             \
    "a user asked for it (agnocast-ctl process revoke), or the process held more than its quota, or kept memory mapped that it must unmap",    \
    "see the log of agnocastd for the user and the reason, then restart the process")                                                          \
  X(store_damaged, "what agnocastd keeps across its restarts is damaged",                                                                      \
    "a fault of the machine, or of agnocastd, or another program has written into its memory",                                                 \
    "stop agnocastd and start it: what it kept is given up, and processes go to it by themselves")                                             \
  X(type_not_found, "there is no support for a message type of this name",                                                                     \
    "the package of the type is not installed or not sourced, or has no type support for introspection",                                       \
    "check the spelling, and source the workspace that has its package (AMENT_PREFIX_PATH)")                                                   \
  X(access_denied, "a rule of [[access]] does not let this user publish or subscribe there",                                                   \
    "the first rule of agnocastd.toml that covers the topic and the action names other users",                                                 \
    "see the allowed users and the rule with agnocast-ctl access TOPIC, and ask the administrator for a rule")                                 \
  X(descriptors_withheld, "agnocastd has answered, but the descriptors of its answer did not arrive",                                          \
    "a security profile (AppArmor, SELinux) keeps them from this process, or something that passes no descriptors stands in between",          \
    "allow it in the profile: share/agnocast/apparmor and share/agnocast/selinux have what it needs, see docs/containers.md")                  \
  X(no_server, "no server is there that could answer",                                                                                         \
    "no process serves this service, or the one that had the request has ended without having answered it",                                    \
    "start the server, wait for it with wait_for_service, and send the request again if it may be done twice")                                 \
  X(already_answered, "this request has been answered",                                                                                        \
    "two responses were sent to one request, or to two copies of it",                                                                          \
    "send one response to each request")                                                                                                       \
  X(daemon_untrusted, "the socket is served by another user that this process does not trust",                                                 \
    "another user's program listens there instead of agnocastd, or agnocastd has a user of its own that this process does not know of",        \
    "name the right socket in AGNOCAST_SOCKET; if that user's daemon is meant, put its number into AGNOCAST_DAEMON_UID")                       \
  X(readers_differ, "the readers of this topic differ from the readers of this process's first topic",                                   \
    "all topics of a process lie in one heap, and the rules of [[access]] let other users subscribe to this topic than to the one that is named beside it", \
    "publish it from another process; or give both topics the same users in [[access]] (agnocast-ctl access TOPIC), restart agnocastd with SIGHUP, and restart this process if the first topic's rule changed")
// clang-format on

/// The codes of all errors that a user of the library can get. Zero is success (the convention of
/// std::error_code).
enum class Errc : std::int32_t {
  ok = 0,
#define AGNOCAST_ERROR_ENUMERATOR(name, sentence, cause, remedy) name,
  AGNOCAST_ERROR_TABLE(AGNOCAST_ERROR_ENUMERATOR)
#undef AGNOCAST_ERROR_ENUMERATOR
};

/// Returns the sentence of a code, static text; "unknown error" for a number outside the table.
/// Any thread; no allocation.
AGNOCAST_PUBLIC const char* sentence_of(Errc code) noexcept;
/// Returns the usual cause, static text; empty for a number outside the table. Any thread; no
/// allocation.
AGNOCAST_PUBLIC const char* cause_of(Errc code) noexcept;
/// Returns what the user can do about it, static text; empty for a number outside the table. Any
/// thread; no allocation.
AGNOCAST_PUBLIC const char* remedy_of(Errc code) noexcept;

/// Returns the enumerator as text, as documentation, log and agnocast-ctl write it:
/// "hook_missing"; "?" for a number outside the table. Any thread; no allocation.
AGNOCAST_PUBLIC const char* word_of(Errc code) noexcept;

/// Returns the std::error_category of Errc, named "agnocast". It lives as long as the process.
AGNOCAST_PUBLIC const std::error_category& error_category() noexcept;
inline std::error_code make_error_code(Errc code) noexcept {
  return {static_cast<int>(code), error_category()};
}

/// Why a function that returns Result failed. Trivially copyable; `what` is static text, never
/// owned.
///
/// Details of one failure (a path, a name, a limit and its value) do not fit into a small value.
/// The library keeps them as text in the thread that got the failure, until that thread gets the
/// next one with a detail; `detail` is the number of that text. text_of() joins everything into
/// one sentence.
struct Failure {
  Errc code = Errc::internal;
  int os_errno = 0;          ///< errno of the refusing call, 0 when no call was involved
  const char* what = "";     ///< which part failed, in plain words
  std::uint64_t detail = 0;  ///< see detail_of(); 0 = none
};

/// Returns the details as text; "" if there are none, if another thread got the failure, or if
/// this thread has got a later one with a detail. Valid until then. No allocation.
AGNOCAST_PUBLIC const char* detail_of(const Failure& failure) noexcept;
/// Returns the failure as one sentence, "what: why": the sentence of its code, then its detail
/// (or its part), then the text of its errno.
AGNOCAST_PUBLIC std::string text_of(const Failure& failure);
/// Makes a Failure with `detail`, cut to detail_bytes_max, for the calling thread. No allocation.
/// Not for the data path, which uses codes alone.
AGNOCAST_PUBLIC Failure failure_with(Errc code, const char* detail, int os_errno = 0) noexcept;
/// Enough for two names of 255 bytes, a path, and the words around them.
constexpr std::size_t detail_bytes_max = 1024;

/// Thrown by creation functions of the public interface and by async_send_request(), because
/// rclcpp users expect exceptions there. Publish and take never throw it.
class AGNOCAST_PUBLIC Error : public std::system_error {
 public:
  /// Construct it in the thread that got the failure, before its next one: later the detail is
  /// gone.
  explicit Error(const Failure& failure);
  /// "what: why", as text_of().
  const char* what() const noexcept override { return text_->c_str(); }
  /// Returns a remedy for the user; static text.
  const char* remedy() const noexcept { return remedy_of(failure_.code); }
  /// Returns the value this was made from; its `what` is static text.
  const Failure& failure() const noexcept { return failure_; }

 private:
  Failure failure_;
  std::shared_ptr<const std::string> text_;  // an exception must be copied without throwing
};

}  // namespace agnocast

template <>
struct std::is_error_code_enum<agnocast::Errc> : std::true_type {};
