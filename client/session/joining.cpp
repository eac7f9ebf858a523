// SPDX-License-Identifier: Apache-2.0
//
// Joining: how a process becomes a member. docs/control-plane.md, "Connection and identity".
//
//   connect → hello → welcome: reserve the arena, map board and region → the control thread begins
//
// What comes before the thread may fail and is undone; a daemon that dies meanwhile is asked again
// until the time of a request is over. Coming back later is rejoining.cpp.

#include <client/session/context.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/daemon_socket.hpp>
#include <base/kept_fd.hpp>
#include <base/mapping.hpp>
#include <base/signals.hpp>
#include <base/socket_path.hpp>
#include <base/text.hpp>
#include <base/unix_address.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/library_thread.hpp>
#include <client/process/steps.hpp>
#include <client/process/user_code.hpp>

#include <pthread.h>
#include <sys/epoll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <thread>
#include <utility>

namespace agnocast {

namespace wire = abi::wire;
using wire::Opcode;

namespace {

// A misspelt domain must not silently be domain 0: its node would meet nobody. Nor may who starts a
// program with raised rights choose its domain: other rules may hold in another one.
Result<std::uint64_t> domain_id() {
  const char* const text = std::getenv("ROS_DOMAIN_ID");
  if (text == nullptr || *text == '\0' || std::strcmp(text, "0") == 0) return std::uint64_t{0};
  if (::secure_getenv("ROS_DOMAIN_ID") == nullptr)
    return fail_with(Errc::invalid_argument,
                     "ROS_DOMAIN_ID is set, which a program with raised rights (set-uid, file "
                     "capabilities) does not follow");
  std::uint64_t domain = 0;
  const char* const end = text + std::strlen(text);
  const auto [stop, problem] = std::from_chars(text, end, domain);
  if (problem == std::errc() && stop == end) return domain;
  return fail_with(Errc::invalid_argument,
                   "ROS_DOMAIN_ID is " + in_quotes(text) + ", which is not a number");
}

/// A program that changes its directory comes back to the same daemon. A path that would be too long for
/// an address stays as it is.
std::string from_here(std::string path) {
  if (path.empty() || path.front() == '/') return path;
  char directory[socket_path_bytes_max + 1];
  if (::getcwd(directory, sizeof directory) == nullptr) return path;
  std::string whole = std::string(directory) + "/" + path;
  return whole.size() <= socket_path_bytes_max ? whole : path;
}

/// A daemon is there in a moment, presumably: it has died, or begins. Between two daemons nobody listens at
/// the socket, or it is not there while the lock that is beside it stays.
bool may_begin(const std::string& path, const Failure& why) noexcept {
  if (why.code != Errc::daemon_not_running) return false;
  if (why.os_errno == ECONNREFUSED) return true;
  return why.os_errno == ENOENT && ::access((path + ".lock").c_str(), F_OK) == 0;
}
constexpr std::chrono::seconds begin_patience{1};

std::string process_name() {
  char name[16] = "";
  ::pthread_getname_np(::pthread_self(), name, sizeof name);
  return name;
}

}  // namespace

Result<void> Context::connect() {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  if (Result<void> refused = refuse_after_exit(); !refused) return refused;
  const std::lock_guard lock(connecting_);
  if (state_.is_connected()) return {};
  if (Result<void> known = recognise_forked_children(); !known) return known;
  if (Result<void> ends = end_user_code_at_exit(); !ends) return ends;
  LibraryThread::be_started_here();
  const Result<std::uint64_t> domain = domain_id();
  if (!domain) return tl::unexpected<Failure>(domain.error());
  domain_ = *domain;
  process_name_ = process_name();
  socket_path_ = from_here(socket_path());
  if (Result<void> known = become_known(); !known) return known;
  state_.step(SessionState::Step::connected);
  return {};
}

// A daemon that was there and has died meanwhile comes back: hello has the time of every request. One that
// may have died just before is waited for less.
Result<void> Context::become_known() {
  const auto deadline = Reconnection::Clock::now() + Connection::answer_timeout;
  std::optional<Reconnection::Clock::time_point> refused;  // first
  auto pause = Reconnection::pause_first;
  for (bool was_there = false;; pause = std::min(pause * 2, Reconnection::pause_last)) {
    Result<void> done = say_hello(deadline);
    AGNOCAST_CRASH_POINT(C_thread);
    if (done) done = start_control_thread();
    if (done) return done;
    was_there = was_there || connection_ != nullptr;
    connection_.reset();
    region_ = {};
    arena_.reset();
    board_ = {};
    const auto now = Reconnection::Clock::now();
    if (!refused) refused = now;
    if (done.error().code != Errc::daemon_not_running ||
        !(was_there || may_begin(socket_path_, done.error())) ||
        now + pause >= (was_there ? deadline : *refused + begin_patience))
      return done;
    std::this_thread::sleep_for(pause);
  }
}

Result<void> Context::say_hello(Reconnection::Clock::time_point deadline) {
  const auto left =
      std::chrono::ceil<std::chrono::milliseconds>(deadline - Reconnection::Clock::now());
  Result<PacketSocket> socket =
      connect_to_daemon(socket_path_, std::max(left, std::chrono::milliseconds{0}));
  if (!socket) {
    const Failure& why = socket.error();
    if (why.code == Errc::daemon_untrusted) return tl::unexpected<Failure>(why);
    return fail_with(why.code, "connecting to " + socket_path_, why.os_errno);
  }
  AGNOCAST_CRASH_POINT(C_connect);
  if (wake_ == nullptr) {
    auto wake = ControlWake::make();
    if (!wake) return tl::unexpected<Failure>(wake.error());
    wake_ = std::move(*wake);
  }
  connection_ = std::make_unique<Connection>(waker(), socket_path_);
  connection_->begin(std::move(*socket));

  wire::Hello hello{};
  hello.fingerprint = abi::fingerprint();
  hello.domain = domain_;
  write_name(hello.process_name, process_name_);
  AGNOCAST_CRASH_POINT(C_hello);
  if (Result<void> said = connection_->introduce(Opcode::hello, hello); !said) return said;
  Incoming packet;
  if (Result<void> first = connection_->receive_first(packet, deadline); !first) {
    if (first.error().code != Errc::daemon_not_running) return first;
    return fail_with(Errc::daemon_not_running, socket_path_ + ": " + first.error().what);
  }
  wire::Welcome welcome{};
  if (Result<void> read = packet.read_as(Opcode::welcome, welcome, 2, "the welcome of agnocastd");
      !read)
    return read;
  if (welcome.fingerprint != abi::fingerprint())
    return fail(Errc::layout_mismatch, "the welcome of agnocastd");
  incarnation_ = welcome.incarnation;
  client_ = welcome.client;
  client_generation_ = welcome.client_generation;
  if (Result<void> mapped = map_regions(welcome, packet.packet.fds()); !mapped) return mapped;
  peers_.begin({{client_, client_generation_}, &region_, arena_.get(), wake_});
  // A connection that ends keeps the place of those who map their region. If it has ended before
  // now, the daemon may have looked before; if not, it will find the region mapped.
  return connection_->check_alive();
}

Result<void> Context::map_regions(const wire::Welcome& welcome, std::span<UniqueFd> fds) {
  AGNOCAST_CRASH_POINT(C_arena);
  if (Result<void> reserved = reserve_arena(welcome.arena_base, welcome.arena_bytes); !reserved)
    return reserved;
  say_blocked();
  AGNOCAST_CRASH_POINT(C_regions);
  Result<SparseRegion> board =
      SparseRegion::make(std::move(fds[0]), abi::board_bytes, Mapping::Access::read);
  if (!board) return tl::unexpected<Failure>(board.error());
  board_ = std::move(*board);
  if (Result<void> opened = board_.open(0, abi::page_bytes); !opened) return opened;
  Result<SparseRegion> region = SparseRegion::make(std::move(fds[1]), welcome.client_region_bytes,
                                                   Mapping::Access::read_write);
  if (!region) return tl::unexpected<Failure>(region.error());
  region_ = std::move(*region);
  if (Result<void> claimed = region_.claim(); !claimed) return claimed;
  return region_.open(0, abi::page_bytes);
}

Result<void> Context::reserve_arena(std::uint64_t base, std::uint64_t bytes) {
  const Arena* const before = former_ != nullptr ? former_->arena_.get() : nullptr;
  if (before != nullptr && before->base() == base && before->bytes() == bytes) {
    arena_ = former_->arena_;
    return {};
  }
  // What this process has published lies in the former one, and its readers find it nowhere else.
  if (before != nullptr &&
      (heap_.is_open() ||
       (base < before->base() + before->bytes() && before->base() < base + bytes)))
    return fail(Errc::arena_occupied, "agnocastd has another arena than the one before");
  Result<Arena> arena = Arena::reserve(base, bytes);
  if (!arena) return tl::unexpected<Failure>(arena.error());
  arena_ = std::make_shared<const Arena>(std::move(*arena));
  return {};
}

Result<void> Context::start_control_thread() {
  epoll_ = keep(UniqueFd(::epoll_create1(EPOLL_CLOEXEC)));
  if (!epoll_) return fail(Errc::os_failure, "preparing the control thread", errno);
  for (const int fd : {connection_->fd(), wake_->fd()}) {
    if (Result<void> watched = watch(fd); !watched) return watched;
  }
  connection_->open();
  // A further membership is told of when the endpoints are in it.
  if (state_.is_beginning()) return start_thread();
  const ConnectionState before = state_.set(ConnectionState::connected);
  Result<void> started = start_thread();
  if (!started) state_.set(before);
  return started;
}

Result<void> Context::watch(int fd) noexcept {
  epoll_event event{};
  event.events = EPOLLIN;
  event.data.fd = fd;
  if (::epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0)
    return fail(Errc::os_failure, "preparing the control thread", errno);
  return {};
}

Result<void> Context::start_thread() {
  const int refused = LibraryThread::start(
      "agnocast-ctl",
      [](void* context) -> void* {
        auto* const self = static_cast<Context*>(context);
        {
          const LibraryThread registered([](void* of) noexcept { (*static_cast<Context*>(of)->wake_)(); },
                                         context);
          self->serve();
        }
        if (self->state_.is_dropped()) delete self;
        return nullptr;
      },
      this);
  has_thread_ = refused == 0;
  if (refused == 0) return {};
  // Too many threads, or no room for its stack? Both are EAGAIN.
  if (const Result<Mapping> stack = Mapping::map_private(LibraryThread::small_stack_bytes); !stack)
    return tl::unexpected<Failure>(stack.error());
  return fail(Errc::os_failure, "starting the control thread", refused);
}

void Context::Drop::operator()(Context* context) const noexcept {
  Heap::leave_region(context->region_.base());
  if (!context->has_thread_) {
    delete context;
    return;
  }
  const auto wake = context->wake_;
  context->state_.step(SessionState::Step::drop);  // its thread ends it
  (*wake)();
}

// Ahead of all requests: what the daemon gives must not lie there.
void Context::say_blocked() {
  for (const Arena::Blocked& range : arena_->blocked()) {
    wire::Blocked body{};
    body.base = range.base;
    body.bytes = range.bytes;
    write_name(body.what, std::string_view(range.what).substr(0, sizeof body.what.text - 1));
    connection_->state(Opcode::blocked, body);
  }
}

}  // namespace agnocast
