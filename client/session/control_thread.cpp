// SPDX-License-Identifier: Apache-2.0
//
// The control thread of the context: what the daemon says, in order, and everything that user threads leave to it.

#include <client/heap/heap_return.hpp>
#include <client/process/library_thread.hpp>
#include <client/session/context.hpp>
#include <client/session/reregistration.hpp>

#include <base/kept_fd.hpp>
#include <client/process/steps.hpp>

#include <poll.h>
#include <sys/epoll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <iterator>
#include <map>
#include <new>
#include <utility>

namespace agnocast {

namespace wire = abi::wire;
using wire::Kind;
using wire::Opcode;

namespace {

// Passes over an idle publisher: soon after the last publish, then ever more rarely
// (docs/protocol.md, who runs a pass).
constexpr int timer_first_ms = 100;
constexpr int timer_last_ms = 1000;
// Looks at a subscription that has not linked yet: usually it does within a millisecond.
constexpr int link_look_first_ms = 1;
// Looks at a socket that the daemon has not read empty.
constexpr int output_look_ms = 10;
// Before the next turn when there is no memory.
constexpr int memory_pause_ms = 10;
// Before a new connection because of descriptors that were lost; twice that the next time, up to the longest. It is the
// pause as well between new connections because more bells can be had.
constexpr std::chrono::seconds again_first{1}, again_last{30};
// For one announcement of a subscription: its region and two bells.
constexpr unsigned announced_descriptors = 3;
// Looks at what is left of a membership without a daemon.
constexpr int former_look_ms = 20;

}  // namespace

void Context::serve() noexcept {
  for (;;) {
    try {
      serve_once(passes_due_ms());
      if (state_.is_dropped()) return;
      LibraryThread::look_for_users();
      if (LibraryThread::is_over()) return serve_nobody();
      if (is_former() && is_unused() && let_go_of_everything()) return;
    } catch (const std::bad_alloc&) {
      // A packet may be half done. After a new connection the daemon says again what counts.
      lose_connection();
      ::poll(nullptr, 0, memory_pause_ms);
    }
  }
}

// The process is about to end. What its exit handlers still want of the daemon they do not wait for.
void Context::serve_nobody() noexcept {
  connection_->refuse({Errc::shut_down, 0, "the last thread of this process has ended"});
  tell_state(ConnectionState::island);
}

// In how many milliseconds somebody must look at the publishers again.
int Context::passes_due_ms() {
  const auto all = endpoints_.publishers();
  const bool reclaimable = std::any_of(
      all.begin(), all.end(), [](const auto& publisher) { return publisher->has_reclaimable(); });
  if (!reclaimable) {
    passes_pause_ = timer_last_ms;
  } else {
    passes_pause_ = was_reclaimable_ ? std::min(passes_pause_ * 2, timer_last_ms) : timer_first_ms;
  }
  was_reclaimable_ = reclaimable;
  const bool awaits_link = std::any_of(
      all.begin(), all.end(), [](const auto& publisher) { return publisher->awaits_link(); });
  if (state_.is_alone()) return former_look_ms;
  if (!awaits_link) {
    link_look_ = link_look_first_ms;
    return passes_pause_;
  }
  const int look = link_look_;
  link_look_ = std::min(link_look_ * 2, timer_first_ms);
  return std::min(passes_pause_, look);
}

void Context::serve_once(int timeout_ms) {
  if (reconnection_.state() == Reconnection::State::waiting) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(reconnection_.next_try() -
                                                                   Reconnection::Clock::now());
    timeout_ms = std::clamp(static_cast<int>(left.count()), 0, timeout_ms);
  }
  if (is_output_blocked_) timeout_ms = std::min(timeout_ms, output_look_ms);
  epoll_event events[4];
  int count = 0;
  if (has_lost_kept()) {
    ::poll(nullptr, 0, std::min(timeout_ms, timer_first_ms));
  } else {
    count = ::epoll_wait(epoll_.get(), events, 4, timeout_ms);
    if (count < 0 && errno != EINTR) ::poll(nullptr, 0, output_look_ms);
  }
  look_for_descriptors(count < 0 && errno != EINTR);
  for (int i = 0; i < count; ++i) {
    if (events[i].data.fd == wake_->fd()) {
      std::uint64_t ignored = 0;
      [[maybe_unused]] const ssize_t got = ::read(wake_->fd(), &ignored, sizeof ignored);
    } else {
      read_connection();
    }
  }
  if (said_again_ && Reconnection::Clock::now() >= *said_again_) {
    if (can_open(announced_descriptors)) {
      said_again_.reset();
      lose_connection();
    } else {
      said_again_ = Reconnection::Clock::now() + again_first;
    }
  }
  if (reconnection_.is_due(Reconnection::Clock::now())) reconnect();
  run_errands();
  is_output_blocked_ = connection_->flush();
}

/// At each tick, or `now`. Somebody may have closed descriptors of ours; their numbers may be others' by now.
void Context::look_for_descriptors(bool now) noexcept {
  const auto time = std::chrono::steady_clock::now();
  if (!now && time - descriptors_looked_ < std::chrono::milliseconds{timer_last_ms}) return;
  descriptors_looked_ = time;
  if (!lost_kept() || descriptors_lost_) return;
  descriptors_lost_ = true;
  become_island(
      {Errc::os_failure, EBADF, "this process has closed descriptors that agnocast has opened"});
  LibraryThread::end_sleeps();
  endpoints_.wake_sleepers();
}

void Context::read_connection() {
  while (connection_->fd() >= 0) {
    Incoming packet;
    bool unasked = false;
    const Result<bool> alive = connection_->receive(packet, unasked);
    if (!alive || !*alive) return lose_connection();
    if (!unasked) return;
    if (packet.packet.descriptors_lost) {
      // This process had none free. After a new connection the daemon says all of it again.
      ask_again_later();
      if (packet.header().opcode != Opcode::announce) continue;
    }
    handle(packet);
  }
}

void Context::ask_again_later() noexcept {
  if (said_again_) return;
  const auto now = Reconnection::Clock::now();
  again_pause_ =
      now - again_at_ > 2 * again_last ? again_first : std::min(2 * again_pause_, again_last);
  said_again_ = again_at_ = now + again_pause_;
}

/// Members that are mute, or not mapped, because there were too many get bells and are mapped when others have left.
void Context::look_for_bells() noexcept {
  const auto now = Reconnection::Clock::now();
  if (said_again_ || now < bells_looked_ + again_first || now < bells_asked_ + again_last ||
      reconnection_.state() != Reconnection::State::connected)
    return;
  bells_looked_ = now;
  const bool has_descriptors = DescriptorShare::instance().has_more();
  if (!MappingShare::instance().has_more() && !has_descriptors) return;
  bells_asked_ = now;
  said_again_ = now;
}

void Context::handle(Incoming& packet) {
  AGNOCAST_CRASH_POINT(C_packet);
  switch (packet.header().opcode) {
    case Opcode::announce:
      on_announce(packet);
      break;
    case Opcode::window_announced:
      on_window(packet);
      break;
    case Opcode::forget:
      on_forget(packet);
      break;
    case Opcode::orphaned:
      on_orphaned(packet);
      break;
    case Opcode::kick:
      on_kick(packet);
      break;
    case Opcode::notice:
      on_notice(packet);
      break;
    case Opcode::move_heap:
      on_move_heap(packet);
      break;
    case Opcode::rejoined:
      on_rejoined(packet);
      break;
    case Opcode::own:
      on_own(packet);
      break;
    case Opcode::region:
      on_region(packet);
      break;
    case Opcode::bells_renewed:
      on_bells_renewed(packet);
      break;
    case Opcode::revoked:
      become_island(failure_with(Errc::revoked, detail_of(refusal_of(packet))));
      break;
    case Opcode::refused:
      on_refused(packet);
      break;
    default:
      break;  // a newer daemon may say more than we know
  }
}

namespace {

/// Mute if there is none: nobody has its receiver any more, the daemon or this process had no descriptor for it, or the
/// owner has no share left.
PublisherEndpoint::Bell bell_among(std::span<UniqueFd> fds, std::size_t before, std::uint32_t count,
                                   DescriptorShare::Owner owner) {
  if (count == 0 || count > 2 || fds.size() < before + count) return {};
  auto counted = DescriptorShare::instance().take(owner, count);
  if (!counted) return {};
  const auto bells = fds.subspan(before, count);
  return {count == 1 ? Doorbell(std::move(bells[0]))
                     : Doorbell(std::move(bells[1]), std::move(bells[0])),
          std::move(counted)};
}

}  // namespace

void Context::on_announce(Incoming& packet) {
  wire::Announcement announcement{};
  if (!packet.read(announcement)) return;
  std::size_t used = 0;
  const auto fds = packet.packet.fds();
  std::shared_ptr<Peer> peer = peers_.use(announcement, fds, used);
  const EndpointKey own{announcement.topic, announcement.own_index};
  const PeerOwner owner = peers_.owner_of(announcement);
  bool linked = false;
  if (peer != nullptr && announcement.kind == Kind::publisher) {
    if (const auto subscription = endpoints_.subscription(own, announcement.own_generation)) {
      linked = subscription->add_publisher(
          {announcement.index, announcement.generation, announcement.extent,
           announcement.first_sequence, abi::unpack_qos(announcement.qos),
           announcement.from_start != 0, announcement.quota},
          std::move(peer));
    }
  } else if (announcement.kind == Kind::subscription) {
    const auto publisher = endpoints_.publisher(own, announcement.own_generation);
    const auto now = ReaderShares::Clock::now();
    if (publisher == nullptr) {
      // It is over.
    } else if (peer == nullptr) {
      const bool is_out = unmapped_users_.is_out(owner, now);
      if (!is_out) unmapped_users_.note(owner);
      publisher->note_unmapped({announcement.index, announcement.generation}, owner, is_out, now);
    } else {
      const bool is_new = publisher->attach(
          {announcement.index, announcement.generation, announcement.extent, announcement.executor,
           owner, announcement.quota},
          peer, bell_among(fds, used, announcement.doorbell_count, peer->owner()));
      if (is_new && shares_.is_out(owner, now))
        publisher->withdraw({announcement.index, announcement.generation});
      linked = true;
    }
  }
  // `unlinked` speaks for the whole process: not while another endpoint of ours is linked.
  linked = linked ||
           (announcement.kind == Kind::publisher
                ? endpoints_.is_linked(announcement.topic, announcement.index, announcement.generation)
                : endpoints_.is_attached(announcement.topic, announcement.index, announcement.generation));
  if (linked || packet.packet.descriptors_lost) return;
  say_unlinked(announcement.kind, announcement.topic, announcement.index, announcement.generation);
  // Never mapped, so nobody will unmap it.
  if (!peers_.has({announcement.client, announcement.client_generation}))
    say_unlinked(Kind::region, 0, announcement.client, announcement.client_generation);
}

void Context::on_window(Incoming& packet) {
  wire::WindowAnnounced announced{};
  if (!packet.read(announced) || packet.packet.descriptor_count != 1) return;
  const PeerTable::Key process{announced.client, announced.client_generation};
  // Unmapped meanwhile: what was said of that is void, because this came after it.
  if (!peers_.has(process)) return say_unlinked(Kind::region, 0, process.first, process.second);
  peers_.add_window(process, {announced.window, announced.base, announced.bytes, announced.first},
                    std::move(packet.packet.fds()[0]));
}

void Context::on_forget(Incoming& packet) {
  wire::Reference over{};
  if (!packet.read(over) || over.kind != Kind::subscription) return;
  for (const auto& publisher : endpoints_.publishers()) {
    if (publisher->topic_index() == over.topic) publisher->detach(over.index, over.generation);
  }
  say_unlinked(Kind::subscription, over.topic, over.index, over.generation);
}

void Context::on_orphaned(Incoming& packet) {
  wire::Orphaned gone{};
  if (!packet.read(gone)) return;
  endpoints_.for_each_subscription([&](const EndpointKey& key, const auto& subscription) {
    if (key.first == gone.topic)
      subscription->orphan(gone.index, gone.generation, gone.final_head == 0);
  });
}

// Somebody who reads from here has something else where this heap lies: it goes on elsewhere.
void Context::on_move_heap(Incoming& packet) {
  wire::MoveHeap move{};
  if (packet.read(move)) heap_.growth().move_to(move.window);
}

void Context::on_kick(Incoming& packet) {
  wire::Reference whose{};
  if (!packet.read(whose)) return;
  for (const auto& publisher : endpoints_.publishers()) {
    if (publisher->topic_index() == whose.topic && publisher->identity().index == whose.index)
      publisher->run_errands();
  }
}

// One that belongs to nobody in this moment stays without: its next user is heard by its own looks.
void Context::on_bells_renewed(Incoming& packet) {
  wire::BellsRenewed renewed{};
  if (!packet.read(renewed) || packet.packet.descriptor_count != 2) return;
  const auto fds = packet.packet.fds();
  DoorbellReceiver bells(std::move(fds[0]), std::move(fds[1]));  // afterwards the former ones
  for (const auto& sleeper : Reregistration::instance().sleepers()) {
    if (sleeper->index_in(this) != renewed.executor) continue;
    sleeper->renew(this, bells);
    return;
  }
  places_.renew(renewed.executor, bells);
}

namespace {

void tell(EndpointEvents& events, const wire::Notice& notice) noexcept {
  static_assert(static_cast<int>(QosPolicyKind::durability) ==
                    static_cast<int>(abi::QosPolicy::durability) &&
                static_cast<int>(QosPolicyKind::reliability) ==
                    static_cast<int>(abi::QosPolicy::reliability));
  switch (static_cast<Errc>(notice.code)) {
    case Errc::qos_incompatible:
      events.incompatible_qos(static_cast<QosPolicyKind>(notice.policy));
      break;
    case Errc::type_mismatch:
      events.incompatible_type();
      break;
    case Errc::arena_occupied: {
      wire::Name text = notice.text;
      text.text[sizeof text.text - 1] = '\0';
      events.heap_collision(text.text);
      break;
    }
    default:
      break;  // a newer daemon may say more than we know
  }
}

}  // namespace

void Context::on_notice(Incoming& packet) {
  wire::Notice notice{};
  if (!packet.read(notice)) return;
  const EndpointKey own{notice.topic, notice.index};
  if (notice.kind == Kind::publisher) {
    if (const auto here = endpoints_.publisher(own, notice.generation)) tell(here->events(), notice);
  } else if (notice.kind == Kind::subscription) {
    if (const auto here = endpoints_.subscription(own, notice.generation)) tell(here->events(), notice);
  }
}

void Context::say_unlinked(Kind kind, std::uint32_t topic, std::uint64_t index,
                           std::uint64_t generation) {
  wire::Unlinked body{};
  body.kind = kind;
  body.topic = topic;
  body.index = index;
  body.generation = generation;
  body.seen = connection_->seen();
  connection_->post(Opcode::unlinked, body);
}

void Context::run_errands() {
  HeapReturn::instance().look();
  if (state_.is_alone()) return run_former_errands();
  if (reconnection_.state() == Reconnection::State::connected &&
      state_.step(SessionState::Step::speak)) {
    state_.give_reason(Errc::ok);
    tell_state(ConnectionState::connected);
  }
  look_for_bells();
  departures_.say(*connection_, wake_);
  look_at_readers();
  collect_publishers();
  collect_subscriptions();
  collect_peers();
  departures_.see_strangers_off(*connection_, wake_, board_);
  heap_.ask_for_window(*connection_, region_.base());
}

// Passes, and what is over.
void Context::collect_publishers() {
  for (const auto& publisher : endpoints_.publishers()) {
    publisher->run_errands();
    if (!publisher->is_over()) continue;
    AGNOCAST_CRASH_POINT(C_publisher_over);
    const auto members = publisher->detach_all();
    const auto& identity = publisher->identity();
    const std::uint32_t topic = publisher->topic_index();
    endpoints_.erase(*publisher);
    AGNOCAST_CRASH_POINT(C_erased);
    // Another publisher of ours on this topic may be attached to some of them, and not to others.
    for (const auto& [index, generation] : members) {
      if (!endpoints_.is_attached(topic, index, generation))
        say_unlinked(Kind::subscription, topic, index, generation);
    }
    connection_->post(Opcode::drained,
                      reference(Kind::publisher, topic, identity.index, identity.generation));
  }
}

void Context::collect_subscriptions() {
  endpoints_.collect_subscriptions(
      [this](std::uint32_t topic, const Link& link) {
        say_unlinked(Kind::publisher, topic, link.publisher(), link.generation());
      },
      [this](const EndpointKey& key, std::uint64_t generation) {
        connection_->post(Opcode::drained,
                          reference(Kind::subscription, key.first, key.second, generation));
      });
}

void Context::collect_peers() {
  peers_.collect([this](const PeerTable::Key& process) {
    say_unlinked(Kind::region, 0, process.first, process.second);
  });
}

// --- a membership whose daemon will not come back: nobody says who is gone, so this thread looks

void Context::run_former_errands() {
  for (const auto& publisher : endpoints_.publishers()) publisher->run_errands();
  const auto now = std::chrono::steady_clock::now();
  if (now - former_looked_ < std::chrono::milliseconds{former_look_ms}) return;
  former_looked_ = now;
  if (present_.load(std::memory_order_acquire) == this) Reregistration::instance().go_on();
  for (const auto& publisher : endpoints_.publishers()) {
    publisher->bury_dead();
    if (!publisher->is_finished()) continue;
    AGNOCAST_CRASH_POINT(C_finish);
    publisher->finish();
    AGNOCAST_CRASH_POINT(C_finish);
    endpoints_.erase(*publisher);
  }
  for (const auto& subscription : endpoints_.subscriptions()) {
    subscription->collect_alone();
    if (!subscription->is_finished()) continue;
    AGNOCAST_CRASH_POINT(C_finish);
    subscription->finish();
    AGNOCAST_CRASH_POINT(C_finish);
    endpoints_.erase(*subscription);
  }
  peers_.collect_alone();
}

bool Context::is_unused() {
  return endpoints_.is_empty() && peers_.is_empty();
}

// Nobody has anything of it any more but sleepers, and those let go here.
bool Context::let_go_of_everything() {
  Reregistration::instance().release_places(*this);
  if (!places_.end()) return false;  // in a moment
  AGNOCAST_CRASH_POINT(C_former_end);
  Heap::leave_region(region_.base());
  AGNOCAST_CRASH_POINT(C_former_end);
  departures_.forget_strangers();
  region_ = {};
  board_ = {};
  arena_.reset();
  AGNOCAST_CRASH_POINT(C_former_end);
  epoll_.reset();
  ControlWake::give_back(wake_);
  return true;
}

}  // namespace agnocast
