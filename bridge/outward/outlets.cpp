// SPDX-License-Identifier: Apache-2.0

#include <bridge/outward/outlets.hpp>

#include <algorithm>
#include <chrono>
#include <exception>
#include <string>
#include <utility>

namespace agnocast::bridge {
namespace {

// If the own local reader has brought this many messages behind a gap, no other reader will fill
// it. Fewer than a subscription may hold by default, so that the reader continues.
constexpr std::size_t behind_gap_max = 32;

}  // namespace

void Outlets::pass(GenericMessage message, const ReaderKey& tap, const CdrType& type) noexcept try {
  const std::uint64_t publisher = message.info().publisher;
  std::unique_lock lock(mutex_);
  if (const auto found = open_.find(publisher); found != open_.end()) {
    const std::shared_ptr<OpenOutlet> outlet = found->second;
    lock.unlock();
    const std::lock_guard order(outlet->order);
    const bool is_own = outlet->plan.tap == tap;
    if (!outlet->has_begun && tap.of.key == outlet->plan.tap.of.key) {
      lock.lock();
      const auto own = waiting_.find({publisher, tap});
      if (is_own && own != waiting_.end() &&
          own->second.messages.size() >= std::min(tap.depth, behind_gap_max))
        catch_up(*outlet, publisher, true);  // before it overwrites its own messages
      (void)keep(std::move(message), tap, type);
      catch_up(*outlet, publisher);
      const bool waits = waiting_.contains({publisher, tap});
      lock.unlock();
      write_soon(outlet);
      if (waits) wake_();
      return;
    }
    if (!is_own || !outlet->is_newer(message.info())) return;
    if (outlet->waited.empty() && !outlet->is_held && write(*outlet, message)) return;
    outlet->waited.push_back(std::move(message));
    try {
      write_soon(outlet);
    } catch (...) {
      outlet->waited.pop_back();
      throw;
    }
    return;
  }
  if (without_.contains(publisher)) return;
  const bool is_new = keep(std::move(message), tap, type);
  lock.unlock();
  if (is_new) wake_();
} catch (const std::exception& error) {
  lose(1, error.what());
}

bool Outlets::keep(GenericMessage message, const ReaderKey& tap, const CdrType& type) {
  const WindowSet within = windows_of(message);
  const std::size_t bytes = held_bytes_of(cdr_bytes(type, message.get(), &within));
  const auto [at, is_new] = waiting_.try_emplace({message.info().publisher, tap});
  Queue& queue = at->second;
  if (is_new) queue.since = std::chrono::steady_clock::now();
  if (!tap.keep_all && queue.messages.size() >= tap.depth) drop_front(queue);
  if (held_bytes_ + bytes > held_bytes_max) {
    lose(1, "too much waits for publishers that agnocastd has not announced yet");
    return is_new;
  }
  queue.bytes.push_back(bytes);
  held_bytes_ += bytes;
  queue.messages.push_back(std::move(message));
  return is_new;
}

void Outlets::drop_front(Queue& queue) {
  held_bytes_ -= queue.bytes.front();
  queue.bytes.pop_front();
  queue.messages.pop_front();
  ++queue.dropped;
}

template <class Condition>
void Outlets::end_waiting_if(Condition condition) {
  std::erase_if(waiting_, [&](const auto& entry) {
    if (!condition(entry.first, entry.second)) return false;
    for (const std::size_t bytes : entry.second.bytes) held_bytes_ -= bytes;
    return true;
  });
}

void Outlets::lose(std::size_t messages, const char* why) noexcept {
  const std::uint64_t lost = lost_ += messages;
  if (!tells_lost_.now()) return;
  try {
    log_.write(LogLevel::warning, "first messages lost",
               {{"dropped", std::to_string(lost)}, {"why", why}});
  } catch (const std::exception&) {
  }
}

void Outlets::open(std::uint64_t publisher, std::unique_ptr<OpenOutlet> outlet) {
  const std::shared_ptr<OpenOutlet> opened = std::move(outlet);
  {
    const std::lock_guard lock(mutex_);
    catch_up(*opened, publisher);
    if (auto& place = open_[publisher]; place != nullptr) {
      end(std::exchange(place, opened));
    } else {
      place = opened;
    }
    ending_.erase(publisher);
  }
  const std::lock_guard order(opened->order);
  write_soon(opened);
}

void Outlets::catch_up(OpenOutlet& outlet, std::uint64_t publisher, bool is_late) {
  struct Due {
    GenericMessage message;
    bool is_own = false;
  };
  std::map<std::uint64_t, Due> due;  // by sequence number; each local reader may have it
  for (auto& [key, queue] : waiting_) {
    if (key.first != publisher || key.second.of.key != outlet.plan.tap.of.key) continue;
    const bool is_own = key.second == outlet.plan.tap;
    if (const std::size_t dropped = std::exchange(queue.dropped, 0); is_own && dropped != 0)
      lose(dropped, "more than the depth of their publisher, before its writer had begun");
    for (const GenericMessage& message : queue.messages) {
      Due& one = due[message.info().sequence];
      one.message = message;
      one.is_own |= is_own;
    }
  }
  for (auto& [sequence, one] : due) {
    if (!outlet.has_begun && !is_late && sequence > outlet.newest + 1) return;
    if (outlet.has_begun && !one.is_own) continue;
    outlet.has_begun |= one.is_own;
    if (outlet.is_newer(one.message.info())) outlet.waited.push_back(std::move(one.message));
  }
  end_waiting_if([&](const Waiting& key, const Queue&) { return key.first == publisher; });
}

void Outlets::write_soon(const std::shared_ptr<OpenOutlet>& outlet) {
  if (outlet->waited.empty() || outlet->is_held) return;
  opener_.add([this, outlet] { return write_waited(*outlet); });
  outlet->is_held = true;
}

// One at a time: a writer that waits for its readers delays the others only by that.
bool Outlets::write_waited(OpenOutlet& outlet) {
  GenericMessage message;
  {
    const std::lock_guard order(outlet.order);
    if (outlet.is_over) {
      outlet.traffic.unacknowledged += outlet.waited.size();
      outlet.waited.clear();
    }
    outlet.is_held = !outlet.waited.empty();
    if (!outlet.is_held) return false;
    message = outlet.waited.front();
  }
  bool is_written = true;
  try {
    is_written = write(outlet, message);
  } catch (const std::exception&) {
    ++outlet.traffic.refused;
  }
  const std::lock_guard order(outlet.order);
  if (is_written) outlet.waited.pop_front();
  return true;
}

void Outlets::end(std::shared_ptr<OpenOutlet> outlet) noexcept {
  outlet->is_over = true;
  reaper_.end(std::move(outlet));
}

void Outlets::close(std::uint64_t publisher) {
  const std::lock_guard lock(mutex_);
  if (const auto found = open_.find(publisher); found != open_.end()) {
    end(std::move(found->second));
    open_.erase(found);
  }
  ending_.erase(publisher);
}

void Outlets::close_all() {
  const std::lock_guard lock(mutex_);
  for (auto& [publisher, outlet] : open_) end(std::move(outlet));
  open_.clear();
  ending_.clear();
  without_.clear();
  end_waiting_if([](const Waiting&, const Queue&) { return true; });
}

void Outlets::close_later(std::uint64_t publisher, Time now) {
  const std::lock_guard lock(mutex_);
  if (open_.contains(publisher)) ending_.try_emplace(publisher, now + linger);
}

bool Outlets::tidy(Time now) {
  const std::lock_guard lock(mutex_);
  const auto is_late = [&](const Queue& queue) { return queue.since + linger < now; };
  std::set<std::uint64_t> behind_gaps;
  for (const auto& [key, queue] : waiting_) {
    if (is_late(queue) && open_.contains(key.first)) behind_gaps.insert(key.first);
  }
  for (const std::uint64_t publisher : behind_gaps) {
    const std::shared_ptr<OpenOutlet>& outlet = open_.at(publisher);
    // Its owner may be waiting for a reader in DDS: then try the next time.
    const std::unique_lock order(outlet->order, std::try_to_lock);
    if (!order) continue;
    catch_up(*outlet, publisher, true);
    write_soon(outlet);
  }
  std::erase_if(ending_, [&](const auto& entry) {
    if (entry.second > now) return false;
    std::shared_ptr<OpenOutlet>& outlet = open_.at(entry.first);
    if (const std::unique_lock order(outlet->order, std::try_to_lock);
        order && !outlet->has_begun) {
      catch_up(*outlet, entry.first, true);
      write_soon(outlet);
    }
    if (outlet->is_held && entry.second + held_linger > now) return false;
    end(std::move(outlet));
    open_.erase(entry.first);
    return true;
  });
  std::size_t late = 0;
  end_waiting_if([&](const Waiting& key, const Queue& queue) {
    if (!is_late(queue) || open_.contains(key.first)) return false;
    late += queue.messages.size() + queue.dropped;
    return true;
  });
  if (late != 0) lose(late, "agnocastd has not announced their publisher within a second");
  return !ending_.empty() || !waiting_.empty();
}

std::set<ReaderKey> Outlets::lingering() const {
  const std::lock_guard lock(mutex_);
  std::set<ReaderKey> keys;
  for (const auto& [publisher, end] : ending_) keys.insert(open_.at(publisher)->plan.tap);
  return keys;
}

void Outlets::forget_waiting(const ReaderKey& tap) {
  const std::lock_guard lock(mutex_);
  end_waiting_if([&](const Waiting& key, const Queue&) { return key.second == tap; });
}

void Outlets::set_without(std::set<std::uint64_t> publishers) {
  const std::lock_guard lock(mutex_);
  without_ = std::move(publishers);
  end_waiting_if([&](const Waiting& key, const Queue&) { return without_.contains(key.first); });
}

bool Outlets::write(OpenOutlet& outlet, const GenericMessage& message) const {
  const CdrType& type = outlet.type->cdr;
  // A publisher may let it refer to the heap of another one, whose messages may not be for DDS.
  const WindowSet within = windows_of(message);
  const std::size_t bytes = cdr_bytes(type, message.get(), &within);
  const auto written = outlet.writer->write(
      bytes,
      [&](std::span<std::byte> room) -> std::size_t {
        return write_cdr(type, message.get(), room, &within).value_or(0);
      },
      static_cast<std::int64_t>(message.info().source_timestamp()));
  if (written && *written == WriteOutcome::sent) {
    outlet.traffic.count(bytes);
    return true;
  }
  const bool would_block = written && *written == WriteOutcome::would_block;
  if (would_block && !outlet.is_over) {
    if (outlet.traffic.tells.now())
      log_.write(LogLevel::notice, "keep-all blocks a publisher",
                 {{"topic", outlet.plan.tap.of.key.topic},
                  {"node", outlet.plan.node},
                  {"why", "a reader in DDS does not acknowledge its messages"}});
    return false;
  }
  const std::uint64_t dropped =
      ++(would_block ? outlet.traffic.unacknowledged : outlet.traffic.refused);
  if (!outlet.traffic.tells.now()) return true;
  log_.write(LogLevel::warning, "message not written",
             {{"topic", outlet.plan.tap.of.key.topic},
              {"node", outlet.plan.node},
              {"sequence", std::to_string(message.info().sequence)},
              {"dropped", std::to_string(dropped)},
              {"why", !written      ? written.error().text()
                      : would_block ? "a reader in DDS does not acknowledge its messages"
                      : bytes == 0  ? "it refers to memory outside its publisher's"
                                   : "it cannot be written as CDR, or there is no memory for it"}});
  return true;
}

}  // namespace agnocast::bridge
