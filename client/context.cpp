// SPDX-License-Identifier: Apache-2.0

#include <client/context.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/signals.hpp>
#include <base/step.hpp>
#include <base/text.hpp>
#include <client/forked_child.hpp>
#include <client/reregistration.hpp>
#include <client/user_code.hpp>

#include <pthread.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <thread>
#include <utility>

namespace agnocast {

namespace wire = abi::wire;
using wire::Kind;
using wire::Opcode;

namespace {

std::string socket_path() {
  if (const char* named = std::getenv("AGNOCAST_SOCKET"); named != nullptr && *named != '\0')
    return named;
  constexpr const char* system_socket = "/run/agnocast/agnocastd.sock";
  if (::access(system_socket, F_OK) == 0) return system_socket;
  if (const char* runtime = std::getenv("XDG_RUNTIME_DIR"); runtime != nullptr && *runtime == '/') {
    return std::string(runtime) + "/agnocast/agnocastd.sock";
  }
  return system_socket;
}

// A misspelt domain must not silently be domain 0: its node would meet nobody.
Result<std::uint64_t> domain_id() {
  const char* const text = std::getenv("ROS_DOMAIN_ID");
  if (text == nullptr || *text == '\0') return std::uint64_t{0};
  std::uint64_t domain = 0;
  const char* const end = text + std::strlen(text);
  const auto [stop, problem] = std::from_chars(text, end, domain);
  if (problem == std::errc() && stop == end) return domain;
  return fail_with(Errc::invalid_argument,
                   "ROS_DOMAIN_ID is " + in_quotes(text) + ", which is not a number");
}

/// The environment may come from whoever starts a setuid program; such a program does not listen.
Result<HeapScope> scope_from_environment(HeapScope otherwise) {
  const char* const text = ::secure_getenv("AGNOCAST_SCOPE");
  if (text == nullptr || *text == '\0') return otherwise;
  const std::string_view word = text;
  if (word == "loan") return HeapScope::loan;
  if (word == "all") return HeapScope::all;
  return fail_with(Errc::invalid_argument,
                   "AGNOCAST_SCOPE is " + in_quotes(text) + ", which is neither loan nor all");
}

std::string process_name() {
  char name[16] = "";
  ::pthread_getname_np(::pthread_self(), name, sizeof name);
  return name;
}

// Destructors of messages run on it. Under mlockall all of it is memory: not the default of 8 MiB.
constexpr std::size_t control_stack_bytes = std::size_t{1} << 20;

constexpr std::chrono::seconds window_pause_last{60};

}  // namespace

Result<bool> is_switched_off() noexcept {
  const char* const text = ::secure_getenv("AGNOCAST");
  const std::string_view word = text != nullptr ? text : "";
  if (word.empty() || word == "on") return false;
  if (word == "off") return true;
  return fail(Errc::invalid_argument, "AGNOCAST must be on or off");
}

std::atomic<Context*> Context::present_{nullptr};

Context& Context::first() noexcept {
  static Context* const context =
      new Context;  // immortal: messages in statics outlive every static of ours
  Context* none = nullptr;
  context->was_present_.store(true, std::memory_order_release);
  present_.compare_exchange_strong(none, context, std::memory_order_acq_rel);
  return *context;
}

bool Context::is_connected() const noexcept {
  return !is_forked_child() && is_connected_.load(std::memory_order_acquire);
}

ConnectionState Context::state() const noexcept {
  return is_forked_child() ? ConnectionState::unconnected : state_.load(std::memory_order_acquire);
}

ConnectionState connection_state() noexcept { return Context::instance().state(); }
Errc island_reason() noexcept { return Context::instance().island_reason(); }

// --- connecting ---

Result<void> Context::connect() {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  if (Result<void> refused = refuse_after_exit(); !refused) return refused;
  const std::lock_guard lock(connecting_);
  if (is_connected_.load(std::memory_order_relaxed)) return {};
  if (Result<void> known = recognise_forked_children(); !known) return known;
  if (Result<void> ends = end_user_code_at_exit(); !ends) return ends;
  socket_path_ = socket_path();
  if (Result<void> known = become_known(); !known) return known;
  is_connected_.store(true, std::memory_order_release);
  return {};
}

// A daemon that was there and has died meanwhile comes back: hello has the time of every request.
Result<void> Context::become_known() {
  const auto deadline = Reconnection::Clock::now() + Connection::answer_timeout;
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
    if (done.error().code != Errc::daemon_not_running || !was_there ||
        Reconnection::Clock::now() + pause >= deadline)
      return done;
    std::this_thread::sleep_for(pause);
  }
}

Result<void> Context::say_hello(Reconnection::Clock::time_point deadline) {
  const Result<std::uint64_t> domain = domain_id();
  if (!domain) return tl::unexpected<Failure>(domain.error());
  const auto left =
      std::chrono::ceil<std::chrono::milliseconds>(deadline - Reconnection::Clock::now());
  Result<PacketSocket> socket =
      PacketSocket::connect(socket_path_, std::max(left, std::chrono::milliseconds{0}));
  if (!socket) {
    const Failure& why = socket.error();
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
  hello.domain = *domain;
  write_name(hello.process_name, process_name());
  AGNOCAST_CRASH_POINT(C_hello);
  if (Result<void> said = connection_->introduce(Opcode::hello, hello); !said) return said;
  Incoming packet;
  if (Result<void> first = connection_->receive_first(packet, deadline); !first) {
    if (first.error().code != Errc::daemon_not_running) return first;
    return fail_with(Errc::daemon_not_running, socket_path_ + ": " + first.error().what);
  }
  wire::Welcome welcome{};
  if (packet.header().opcode != Opcode::welcome || !packet.read(welcome) ||
      packet.packet.descriptor_count != 2) {
    return fail(Errc::protocol_violation, "the welcome of agnocastd");
  }
  if (welcome.fingerprint != abi::fingerprint())
    return fail(Errc::layout_mismatch, "the welcome of agnocastd");
  incarnation_ = welcome.incarnation;
  client_ = welcome.client;
  client_generation_ = welcome.client_generation;
  if (Result<void> mapped = map_regions(welcome, packet.packet.fds()); !mapped) return mapped;
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
  region_.claim();
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
      (heap_is_open_.load(std::memory_order_relaxed) ||
       (base < before->base() + before->bytes() && before->base() < base + bytes)))
    return fail(Errc::arena_occupied, "agnocastd has another arena than the one before");
  Result<Arena> arena = Arena::reserve(base, bytes);
  if (!arena) return tl::unexpected<Failure>(arena.error());
  arena_ = std::make_shared<const Arena>(std::move(*arena));
  return {};
}

Result<void> Context::start_control_thread() {
  epoll_.reset(::epoll_create1(EPOLL_CLOEXEC));
  if (!epoll_) return fail(Errc::os_failure, "preparing the control thread", errno);
  for (const int fd : {connection_->fd(), wake_->fd()}) {
    if (Result<void> watched = watch(fd); !watched) return watched;
  }
  connection_->open();
  // A further membership is told of when the endpoints are in it.
  const ConnectionState before = state_.load(std::memory_order_relaxed);
  if (former_ == nullptr) state_.store(ConnectionState::connected, std::memory_order_release);
  if (Result<void> started = start_thread(); !started) {
    state_.store(before, std::memory_order_release);
    return started;
  }
  return {};
}

Result<void> Context::watch(int fd) noexcept {
  epoll_event event{};
  event.events = EPOLLIN;
  event.data.fd = fd;
  if (::epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0)
    return fail(Errc::os_failure, "preparing the control thread", errno);
  return {};
}

int Context::start_service_thread(const char* name, void* (*body)(void*), void* argument) noexcept {
  pthread_attr_t attributes;
  ::pthread_attr_init(&attributes);
  ::pthread_attr_setstacksize(&attributes, control_stack_bytes);
  pthread_t thread{};
  const int refused = [&] {
    const SignalsBlocked blocked;
    return ::pthread_create(&thread, &attributes, body, argument);
  }();
  ::pthread_attr_destroy(&attributes);
  if (refused != 0) return refused;
  ::pthread_setname_np(thread, name);
  ::pthread_detach(thread);
  return 0;
}

Result<void> Context::start_thread() {
  const int refused = start_service_thread(
      "agnocast-ctl",
      [](void* context) -> void* {
        auto* const self = static_cast<Context*>(context);
        self->serve();
        if (self->is_dropped_.load(std::memory_order_acquire)) delete self;
        return nullptr;
      },
      this);
  if (refused == 0) return {};
  // Too many threads, or no room for its stack? Both are EAGAIN.
  if (const Result<Mapping> stack = Mapping::map_private(control_stack_bytes); !stack)
    return tl::unexpected<Failure>(stack.error());
  return fail(Errc::os_failure, "starting the control thread", refused);
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

// --- creating and destroying ---

Result<void> Context::set_heap_scope(HeapScope scope) noexcept {
  if (Result<void> refused = refuse_forked_child(); !refused) return refused;
  const std::lock_guard lock(connecting_);
  if (heap_is_open_.load(std::memory_order_relaxed) && scope != scope_)
    return fail(Errc::invalid_argument, "the scope of a heap that is open stays as it is");
  scope_ = scope;
  return {};
}

Result<void> Context::open_heap() {
  const std::lock_guard lock(connecting_);
  if (heap_is_open_.load(std::memory_order_relaxed)) return {};
  Result<Heap> found = Heap::find();
  if (!found) return tl::unexpected<Failure>(found.error());
  const Result<HeapScope> scope = scope_from_environment(scope_);
  if (!scope) return tl::unexpected<Failure>(scope.error());
  wire::WindowRequest request{};
  request.window = 0;
  Result<void> opened =
      connection_->request(Opcode::open_window, request, [&](Incoming& packet) -> Result<void> {
        wire::WindowOpened window{};
        if (!packet.read(window) || packet.packet.descriptor_count != 2)
          return fail(Errc::protocol_violation, "a heap window");
        const auto fds = packet.packet.fds();
        return found->attach(region_.base(), window.base, window.bytes, std::move(fds[0]),
                             fds[1].get(), *scope,
                             []() noexcept { Context::instance().wake_control(); });
      });
  if (!opened) return opened;
  heap_ = *found;
  scope_ = *scope;
  heap_is_open_.store(true, std::memory_order_release);
  return {};
}

// What lies in the windows stays where it is, and so do they: the new daemon is told of them.
Result<void> Context::bring_windows() {
  if (!heap_is_open_.load(std::memory_order_acquire)) return {};
  if (!Heap::follow(region_.base()))
    return fail(Errc::limit_reached, "too many former memberships are still in use");
  for (std::uint64_t i = 0; i < Heap::window_count(); ++i) {
    const Heap::Window window = Heap::window(i);
    wire::BringWindow body{};
    body.window = i;
    body.base = window.base;
    body.bytes = window.length;
    body.first = window.first;
    Result<void> brought = connection_->request(
        Opcode::bring_window, body, [](Incoming&) { return Result<void>(); }, nullptr, false,
        window.write_fd);
    if (!brought) return brought;
  }
  window_count_ = Heap::window_count();
  return {};
}

// Ahead of need: malloc never waits for the daemon. While the answer is on its way, or when it is a
// refusal, the heap does with what it has.
void Context::ask_for_window() {
  if (!heap_is_open_.load(std::memory_order_acquire) || window_asked_ || !may_grow_.load()) return;
  if (move_to_ != window_count_ && !heap_->wants_window()) return;
  if (std::chrono::steady_clock::now() < window_again_) return;
  window_asked_ = true;
  wire::WindowRequest request{};
  request.window = window_count_;
  connection_->request_later(Opcode::open_window, request, [this](Result<Incoming*> answer) {
    // All windows that this process may have: no other answer will come.
    if (!answer && answer.error().code == Errc::window_exhausted) return heap_->no_more_windows();
    window_asked_ = false;
    if (answer && add_window(**answer)) {
      window_pause_ = window_pause_first;
      if (++window_count_ == abi::window_count_max) heap_->no_more_windows();
      return;
    }
    // What is missing (quota, arena, memory) may come back: asked again ever more rarely, because a
    // full heap would ask at every errand.
    window_again_ = std::chrono::steady_clock::now() + window_pause_;
    window_pause_ = std::min(window_pause_ * 2, window_pause_last);
  });
}

bool Context::add_window(Incoming& answer) noexcept {
  wire::WindowOpened opened{};
  if (!answer.read(opened) || answer.packet.descriptor_count != 2) return false;
  if (opened.window != window_count_) return false;
  // The daemon announces it to everybody else. Before it is in use, so that nobody waits for it.
  if (const auto own = peers_.find({client_, client_generation_}); own != peers_.end())
    (void)add_window_of(own->second, {opened.window, opened.base, opened.bytes, opened.first},
                        UniqueFd());
  const auto fds = answer.packet.fds();
  return heap_
      ->add_window(region_.base(), opened.window, opened.base, opened.bytes, std::move(fds[0]),
                   fds[1].get(), opened.first == opened.window)
      .has_value();
}

namespace {

Result<wire::CreateEndpoint> describe(const EndpointRequest& request,
                                      std::uint64_t executor) noexcept {
  wire::CreateEndpoint body{};
  body.qos = abi::pack_qos(request.qos);
  body.layout_hash = request.layout_hash;
  body.executor = executor;
  body.quota = request.quota;
  if (!write_name(body.topic, request.topic))
    return fail(Errc::invalid_name, "a topic name of more than 255 characters");
  if (!write_name(body.type, request.type))
    return fail(Errc::invalid_name, "a type name of more than 255 characters");
  if (!write_name(body.node, request.node))
    return fail(Errc::invalid_name, "a node name of more than 255 characters");
  return body;
}

}  // namespace

// The topic's entry on the board, and the endpoint's own words.
Result<void> Context::open_extents(const wire::EndpointCreated& made, std::uint64_t bytes) {
  AGNOCAST_CRASH_POINT(C_extent_open);
  Result<void> opened = board_.open(abi::topic_offset(made.topic), abi::topic_bytes);
  return opened ? region_.open(made.extent, bytes) : opened;
}

template <class Work>
auto Context::in_present(Work work) -> decltype(work(instance())) {
  const auto deadline = Reconnection::Clock::now() + Connection::answer_timeout;
  for (;;) {
    Context& present = instance();
    auto done = work(present);
    if (done || done.error().code != Errc::started_anew ||
        !Reregistration::instance().wait_for_next(present, deadline))
      return done;
  }
}

Result<std::shared_ptr<PublisherEndpoint>> Context::create_publisher(
    const EndpointRequest& request, void (*destroy_message)(void*) noexcept) {
  auto made = in_present(
      [&](Context& present) { return present.make_publisher(request, destroy_message, nullptr); });
  if (made) Reregistration::instance().add(*made, request, destroy_message);
  return made;
}

Result<std::shared_ptr<SubscriptionEndpoint>> Context::create_subscription(
    const EndpointRequest& request, std::shared_ptr<Sleeper> sleeper) {
  auto made = in_present(
      [&](Context& present) { return present.make_subscription(request, sleeper, nullptr); });
  if (made) Reregistration::instance().add(*made, request);
  return made;
}

Result<std::shared_ptr<Sleeper>> Context::create_sleeper() {
  auto sleeper = std::make_shared<Sleeper>();
  Result<void> made = in_present([&](Context& present) { return present.make_place(*sleeper); });
  if (!made) return tl::unexpected<Failure>(made.error());
  Reregistration::instance().add(sleeper);
  return sleeper;
}

Result<std::shared_ptr<Sleeper>> Context::idle_sleeper() {
  if (Result<void> refused = refuse_forked_child(); !refused)
    return tl::unexpected<Failure>(refused.error());
  struct Idle {
    std::mutex making;
    std::shared_ptr<Sleeper> sleeper;
  };
  static Idle* const idle = new Idle;  // immortal, as the context
  const std::lock_guard lock(idle->making);
  if (idle->sleeper == nullptr) {
    auto made = create_sleeper();
    if (!made) return made;
    idle->sleeper = std::move(*made);
  }
  return idle->sleeper;
}

Result<std::shared_ptr<PublisherEndpoint>> Context::make_publisher(
    const EndpointRequest& request, void (*destroy_message)(void*) noexcept,
    std::shared_ptr<EndpointEvents> events) {
  if (Result<void> connected = connect(); !connected)
    return tl::unexpected<Failure>(connected.error());
  if (Result<void> heap = open_heap(); !heap) return tl::unexpected<Failure>(heap.error());
  if (!request.uses_shared_allocator) {
    if (Result<void> interposes = heap_->check_interposition(); !interposes)
      return tl::unexpected<Failure>(interposes.error());
  }
  const Result<wire::CreateEndpoint> body = describe(request, 0);
  if (!body) return tl::unexpected<Failure>(body.error());
  std::shared_ptr<PublisherEndpoint> publisher;
  Result<void> created = connection_->request(
      Opcode::create_publisher, *body,
      [&](Incoming& packet) -> Result<void> {
        wire::EndpointCreated made{};
        if (!packet.read(made) || made.topic >= abi::topic_count_max ||
            made.index >= abi::publisher_count_max) {
          return fail(Errc::protocol_violation, "a new publisher");
        }
        if (Result<void> opened = open_extents(made, abi::publisher_extent_bytes); !opened)
          return opened;
        const PublisherEndpoint::Core::Identity core{{board_.base(), abi::topic_offset(made.topic)},
                                                     {region_.base(), made.extent},
                                                     made.index,
                                                     made.generation,
                                                     made.first_sequence,
                                                     request.qos,
                                                     made.slot_count,
                                                     0};
        publisher = std::make_shared<PublisherEndpoint>(
            PublisherEndpoint::Identity{core, made.topic, destroy_message, waker(), events, this});
        const std::lock_guard lock(endpoints_);
        AGNOCAST_CRASH_POINT(C_registered);
        publishers_[{made.topic, made.index}] = publisher;
        return {};
      },
      [this](Incoming& packet) { return adopt_late(Kind::publisher, packet); });
  if (!created) return tl::unexpected<Failure>(created.error());
  return publisher;
}

Result<std::shared_ptr<SubscriptionEndpoint>> Context::make_subscription(
    const EndpointRequest& request, const std::shared_ptr<Sleeper>& sleeper,
    std::shared_ptr<EndpointEvents> events) {
  if (Result<void> connected = connect(); !connected)
    return tl::unexpected<Failure>(connected.error());
  // The sleeper may be older than this membership.
  if (Result<void> place = make_place(*sleeper); !place)
    return tl::unexpected<Failure>(place.error());
  const Result<wire::CreateEndpoint> body = describe(request, *sleeper->index_in(this));
  if (!body) return tl::unexpected<Failure>(body.error());
  std::shared_ptr<SubscriptionEndpoint> subscription;
  Result<void> created = connection_->request(
      Opcode::create_subscription, *body,
      [&](Incoming& packet) -> Result<void> {
        wire::EndpointCreated made{};
        if (!packet.read(made) || made.topic >= abi::topic_count_max ||
            made.index >= abi::subscription_count_max) {
          return fail(Errc::protocol_violation, "a new subscription");
        }
        if (Result<void> opened = open_extents(made, abi::subscription_extent_bytes); !opened)
          return opened;
        subscription = std::make_shared<SubscriptionEndpoint>(
            SubscriptionEndpoint::Identity{{board_.base(), abi::topic_offset(made.topic)},
                                           made.topic,
                                           made.index,
                                           made.generation,
                                           region_.base(),
                                           made.extent,
                                           request.qos,
                                           request.quota,
                                           request.message_bytes,
                                           request.message_alignment,
                                           waker(),
                                           events,
                                           this},
            sleeper);
        const std::lock_guard lock(endpoints_);
        AGNOCAST_CRASH_POINT(C_registered);
        subscriptions_[{made.topic, made.index}] = subscription;
        return {};
      },
      [this](Incoming& packet) { return adopt_late(Kind::subscription, packet); });
  if (!created) return tl::unexpected<Failure>(created.error());
  return subscription;
}

// A place goes back to the context, not away: it stays the process's, with its bells, and its sleep
// word goes on counting.
std::shared_ptr<Sleeper::Place> Context::lend(std::unique_ptr<Sleeper::Place> place) {
  return {place.release(), [this](Sleeper::Place* returned) noexcept {
            if (is_forked_child()) return;
            const std::lock_guard lock(sleepers_);
            unused_places_.emplace_back(returned);  // within its capacity
            --lent_places_;
          }};
}

Result<void> Context::make_place(Sleeper& sleeper) {
  if (Result<void> connected = connect(); !connected) return connected;
  const std::lock_guard making(places_making_);
  if (sleeper.index_in(this)) return {};
  wire::ExecutorRequest request{};
  bool again = false;
  std::unique_ptr<Sleeper::Place> place;
  {
    const std::lock_guard lock(sleepers_);
    unused_places_.reserve(abi::executor_count_max);
    failed_sleepers_.reserve(abi::executor_count_max);
    if (!unused_places_.empty()) {
      place = std::move(unused_places_.back());
      unused_places_.pop_back();
      ++lent_places_;
    } else if (!failed_sleepers_.empty()) {
      request.executor = failed_sleepers_.back();
      failed_sleepers_.pop_back();
      again = true;
    } else if (next_sleeper_ == abi::executor_count_max) {
      static_assert(abi::executor_count_max == 56);
      return fail(
          Errc::limit_reached,
          "more than 56 nodes with callbacks in one process (polling subscriptions together "
          "count as one)");
    } else {
      request.executor = next_sleeper_++;
    }
  }
  if (place != nullptr) return sleeper.add(this, lend(std::move(place)));
  Result<void> opened = connection_->request(
      Opcode::open_executor, request,
      [&](Incoming& packet) -> Result<void> {
        if (packet.header().opcode != Opcode::executor_opened ||
            packet.packet.descriptor_count != 2) {
          return fail(Errc::protocol_violation, "a new executor");
        }
        const auto fds = packet.packet.fds();
        AGNOCAST_CRASH_POINT(C_sleeper);
        place = std::make_unique<Sleeper::Place>(
            region_.base(), request.executor,
            DoorbellReceiver(std::move(fds[0]), std::move(fds[1])));
        return {};
      },
      nullptr, again);
  {
    const std::lock_guard lock(sleepers_);
    if (opened) {
      ++lent_places_;
    } else {
      // Should the bells come late, nobody wants them; who gets the number next asks for new ones.
      failed_sleepers_.push_back(request.executor);  // within its capacity
    }
  }
  return opened ? sleeper.add(this, lend(std::move(place))) : opened;
}

// The control thread says it, now or when it is connected again.
void Context::wait_for(const Departure& departure) noexcept {
  wake_control();
  std::unique_lock lock(departing_);
  departed_.wait_for(lock, Connection::answer_timeout,
                     [&] { return departure.is_known() || !connection_->is_open(); });
}

void Context::let_leave(PublisherEndpoint& publisher) noexcept {
  publisher.departure().want();
  wait_for(publisher.departure());
}

void Context::let_leave(SubscriptionEndpoint& subscription) noexcept {
  AGNOCAST_CRASH_POINT(C_closed);
  subscription.departure().want();
  wait_for(subscription.departure());
}

// In each membership that it is in.
void Context::destroy(const std::shared_ptr<PublisherEndpoint>& publisher) noexcept {
  if (!is_connected()) return;
  publisher->end();
  const std::shared_ptr<PublisherEndpoint> present = publisher->present(publisher);
  if (present != publisher) publisher->context()->let_leave(*publisher);
  present->context()->let_leave(*present);
}

void Context::destroy(const std::shared_ptr<SubscriptionEndpoint>& subscription) noexcept {
  if (!is_connected()) return;
  subscription->close();
  for (const auto& successor : subscription->successors())
    successor->context()->let_leave(*successor);
  subscription->context()->let_leave(*subscription);
}

void Context::release(const Received& received) noexcept {
  if (is_forked_child()) return;  // the hold is the parent's
  if (!received.link->release(received.taken.slot)) return;
  AGNOCAST_CRASH_POINT(C_release_last);
  received.link->wake_control();
}

}  // namespace agnocast
