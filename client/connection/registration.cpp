// SPDX-License-Identifier: Apache-2.0

#include <client/connection/registration.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <agnocast/connection_state.hpp>
#include <base/memory/mapping.hpp>
#include <base/sockets/daemon_socket.hpp>
#include <base/sockets/socket_path.hpp>
#include <base/sockets/unix_address.hpp>
#include <base/text/text.hpp>
#include <client/process/steps.hpp>

#include <fcntl.h>
#include <pthread.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <string_view>

namespace agnocast {

namespace wire = abi::wire;
using wire::Opcode;

namespace {

constexpr std::uint64_t no_domain = ~std::uint64_t{0};
/// That of the first registration that agnocastd has welcomed: later ones continue from it.
std::atomic<std::uint64_t> registered_domain{no_domain};
/// The client generation of the last one.
std::atomic<std::uint64_t> registered_client{0};

// A misspelt domain must not silently be domain 0: its node would meet no other. The user who
// starts a program with raised rights may not choose its domain either: other rules may hold there.
Result<std::uint64_t> domain_of_environment() {
  const char* const text = std::getenv("ROS_DOMAIN_ID");
  if (text == nullptr || *text == '\0' || std::strcmp(text, "0") == 0) return std::uint64_t{0};
  if (::secure_getenv("ROS_DOMAIN_ID") == nullptr)
    return fail_with(Errc::invalid_argument,
                     "ROS_DOMAIN_ID is set, but a program with raised rights (set-uid, file "
                     "capabilities) does not accept it");
  std::uint64_t domain = 0;
  const char* const end = text + std::strlen(text);
  const auto [stop, problem] = std::from_chars(text, end, domain);
  if (problem == std::errc() && stop == end) return domain;
  return fail_with(Errc::invalid_argument,
                   "ROS_DOMAIN_ID is " + in_quotes(text) + ", which is not a number");
}

/// Makes the path absolute, so that a program that changes its directory finds the same daemon. A
/// path that would be too long for a socket address stays as it is.
std::string from_here(std::string path) {
  if (path.empty() || path.front() == '/') return path;
  char directory[socket_path_bytes_max + 1];
  if (::getcwd(directory, sizeof directory) == nullptr) return path;
  std::string whole = std::string(directory) + "/" + path;
  return whole.size() <= socket_path_bytes_max ? whole : path;
}

/// Returns the name of the program, of which the kernel keeps 15 characters: that of its first
/// thread, whichever connects.
std::string process_name() {
  char name[16] = "";
  const std::string path = "/proc/self/task/" + std::to_string(::getpid()) + "/comm";
  const UniqueFd comm(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  const ssize_t count = comm ? ::read(comm.get(), name, sizeof name) : 0;
  if (count > 0) return {name, static_cast<std::size_t>(count - 1)};  // without the newline
  ::pthread_getname_np(::pthread_self(), name, sizeof name);
  return name;
}

}  // namespace

Result<std::uint64_t> domain_id() {
  const std::uint64_t registered = registered_domain.load(std::memory_order_relaxed);
  if (registered != no_domain) return registered;
  return domain_of_environment();
}

std::uint64_t Registration::last_client() noexcept {
  return registered_client.load(std::memory_order_relaxed);
}

Result<void> Registration::find_daemon() {
  const Result<std::uint64_t> domain = domain_id();
  if (!domain) return tl::unexpected<Failure>(domain.error());
  domain_ = *domain;
  process_name_ = process_name();
  path_ = from_here(socket_path());
  return {};
}

void Registration::continue_from(const Registration& former) {
  former_ = &former;
  path_ = former.path_;
  process_name_ = former.process_name_;
  domain_ = former.domain_;
}

void Registration::undo() noexcept {
  connection_.reset();
  region_ = {};
  arena_.reset();
  board_ = {};
}

Result<void> Registration::say_hello(Clock::time_point deadline, bool heap_is_open) {
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now());
  Result<PacketSocket> socket =
      connect_to_daemon(path_, std::max(left, std::chrono::milliseconds{0}));
  if (!socket) {
    const Failure& why = socket.error();
    if (why.code == Errc::daemon_untrusted) return tl::unexpected<Failure>(why);
    return fail_with(why.code, "connecting to " + path_, why.os_errno);
  }
  AGNOCAST_CRASH_POINT(C_connect);
  if (wake_ == nullptr) {
    auto wake = ControlWake::make();
    if (!wake) return tl::unexpected<Failure>(wake.error());
    wake_ = std::move(*wake);
  }
  connection_ = std::make_unique<Connection>(waker(), path_);
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
    return fail_with(Errc::daemon_not_running, path_ + ": " + first.error().what);
  }
  wire::Welcome welcome{};
  if (Result<void> read = packet.read_as(Opcode::welcome, welcome, 2, "the welcome from agnocastd");
      !read)
    return read;
  if (welcome.fingerprint != abi::fingerprint())
    return fail(Errc::layout_mismatch, "the welcome from agnocastd");
  incarnation_ = welcome.incarnation;
  client_ = {welcome.client, welcome.client_generation};
  registered_domain.store(domain_, std::memory_order_relaxed);
  registered_client.store(welcome.client_generation, std::memory_order_relaxed);
  if (Result<void> mapped = map_regions(welcome, packet.packet.fds(), heap_is_open); !mapped)
    return mapped;
  // After a connection has ended, the daemon keeps the place of a client that has mapped its
  // region. If this one has ended already, the daemon may have looked before the mapping was there;
  // otherwise it will find the region mapped.
  return connection_->check_alive();
}

Result<void> Registration::map_regions(const wire::Welcome& welcome, std::span<UniqueFd> fds,
                                       bool heap_is_open) {
  AGNOCAST_CRASH_POINT(C_arena);
  if (Result<void> reserved = reserve_arena(welcome.arena_base, welcome.arena_bytes, heap_is_open);
      !reserved)
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

Result<void> Registration::reserve_arena(std::uint64_t base, std::uint64_t bytes,
                                         bool heap_is_open) {
  const Arena* const before = former_ != nullptr ? former_->arena_.get() : nullptr;
  if (before != nullptr && before->base() == base && before->bytes() == bytes) {
    arena_ = former_->arena_;
    return {};
  }
  // This process's messages lie in the previous arena; readers find them at no other address.
  if (before != nullptr &&
      (heap_is_open || (base < before->base() + before->bytes() && before->base() < base + bytes)))
    return fail(Errc::arena_occupied, "the new agnocastd uses a different arena");
  Result<Arena> arena = Arena::reserve(base, bytes);
  if (!arena) return tl::unexpected<Failure>(arena.error());
  arena_ = std::make_shared<const Arena>(std::move(*arena));
  return {};
}

// Maps the topic's entry on the board, and the endpoint's own words.
Result<void> Registration::open_extents(const wire::EndpointCreated& made, std::uint64_t bytes) {
  AGNOCAST_CRASH_POINT(C_extent_open);
  Result<void> opened = board_.open(abi::topic_offset(made.topic), abi::topic_bytes);
  return opened ? region_.open(made.extent, bytes) : opened;
}

Result<void> Registration::connect_again() {
  // A full queue may have room at the next attempt.
  Result<PacketSocket> socket = connect_to_daemon(path_, std::chrono::milliseconds{0});
  if (!socket) return tl::unexpected<Failure>(socket.error());
  AGNOCAST_CRASH_POINT(C_reconnect);
  connection_->begin(std::move(*socket));
  return {};
}

Result<void> Registration::say_rejoin() {
  wire::Rejoin rejoin{};
  rejoin.fingerprint = abi::fingerprint();
  rejoin.incarnation = incarnation_;
  rejoin.client = client_.first;
  rejoin.client_generation = client_.second;
  AGNOCAST_CRASH_POINT(C_rejoin);
  return connection_->introduce(Opcode::rejoin, rejoin);
}

void Registration::say_blocked() {
  for (const Arena::Blocked& range : arena_->blocked()) {
    wire::Blocked body{};
    body.base = range.base;
    body.bytes = range.bytes;
    write_name(body.what, std::string_view(range.what).substr(0, sizeof body.what.text - 1));
    connection_->state(Opcode::blocked, body);
  }
}

void Registration::unmap_all() noexcept {
  region_ = {};
  board_ = {};
  arena_.reset();
}

}  // namespace agnocast
