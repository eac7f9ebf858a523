// SPDX-License-Identifier: Apache-2.0

#include <bridge/outward/dds_writers.hpp>

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

void DdsWriters::pass(GenericMessage message, const ReaderKey& local_reader,
                      const CdrType& type) noexcept try {
  const std::uint64_t publisher = message.info().publisher;
  std::unique_lock lock(mutex_);
  if (const auto found = open_.find(publisher); found != open_.end()) {
    const std::shared_ptr<OpenDdsWriter> dds_writer = found->second;
    lock.unlock();
    const std::lock_guard order(dds_writer->order);
    const bool is_own = dds_writer->plan.local_reader == local_reader;
    if (!dds_writer->has_begun && local_reader.of.key == dds_writer->plan.local_reader.of.key) {
      lock.lock();
      const auto own = waiting_.find({publisher, local_reader});
      if (is_own && own != waiting_.end() &&
          own->second.messages.size() >= std::min(local_reader.depth, behind_gap_max))
        catch_up(*dds_writer, publisher, true);  // before it overwrites its own messages
      (void)keep(std::move(message), local_reader, type);
      catch_up(*dds_writer, publisher);
      const bool waits = waiting_.contains({publisher, local_reader});
      lock.unlock();
      write_soon(dds_writer);
      if (waits) wake_();
      return;
    }
    if (!is_own || !dds_writer->is_newer(message.info())) return;
    if (dds_writer->waited.empty() && !dds_writer->is_held && write(*dds_writer, message)) return;
    dds_writer->waited.push_back(std::move(message));
    try {
      write_soon(dds_writer);
    } catch (...) {
      dds_writer->waited.pop_back();
      throw;
    }
    return;
  }
  if (without_.contains(publisher)) return;
  const bool is_new = keep(std::move(message), local_reader, type);
  lock.unlock();
  if (is_new) wake_();
} catch (const std::exception& error) {
  lose(1, error.what());
}

bool DdsWriters::keep(GenericMessage message, const ReaderKey& local_reader, const CdrType& type) {
  const WindowSet within = windows_of(message);
  const std::size_t bytes = held_bytes_of(cdr_bytes(type, message.get(), &within));
  const auto [at, is_new] = waiting_.try_emplace({message.info().publisher, local_reader});
  Queue& queue = at->second;
  if (is_new) queue.since = std::chrono::steady_clock::now();
  if (!local_reader.keep_all && queue.messages.size() >= local_reader.depth) drop_front(queue);
  if (held_bytes_ + bytes > held_bytes_max) {
    lose(1, "too much waits for publishers that agnocastd has not announced yet");
    return is_new;
  }
  queue.bytes.push_back(bytes);
  held_bytes_ += bytes;
  queue.messages.push_back(std::move(message));
  return is_new;
}

void DdsWriters::drop_front(Queue& queue) {
  held_bytes_ -= queue.bytes.front();
  queue.bytes.pop_front();
  queue.messages.pop_front();
  ++queue.dropped;
}

template <class Condition>
void DdsWriters::end_waiting_if(Condition condition) {
  std::erase_if(waiting_, [&](const auto& entry) {
    if (!condition(entry.first, entry.second)) return false;
    for (const std::size_t bytes : entry.second.bytes) held_bytes_ -= bytes;
    return true;
  });
}

void DdsWriters::lose(std::size_t messages, const char* why) noexcept {
  const std::uint64_t lost = lost_ += messages;
  if (!reports_lost_.now()) return;
  try {
    log_.write(LogLevel::warning, "first messages lost",
               {{"dropped", std::to_string(lost)}, {"why", why}});
  } catch (const std::exception&) {
  }
}

void DdsWriters::open(std::uint64_t publisher, std::unique_ptr<OpenDdsWriter> dds_writer) {
  const std::shared_ptr<OpenDdsWriter> opened = std::move(dds_writer);
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

void DdsWriters::catch_up(OpenDdsWriter& dds_writer, std::uint64_t publisher, bool is_late) {
  struct Due {
    GenericMessage message;
    bool is_own = false;
  };
  std::map<std::uint64_t, Due> due;  // by sequence number; each local reader may have it
  for (auto& [key, queue] : waiting_) {
    if (key.first != publisher || key.second.of.key != dds_writer.plan.local_reader.of.key)
      continue;
    const bool is_own = key.second == dds_writer.plan.local_reader;
    if (const std::size_t dropped = std::exchange(queue.dropped, 0); is_own && dropped != 0)
      lose(dropped, "more than the depth of their publisher, before its writer had begun");
    for (const GenericMessage& message : queue.messages) {
      Due& one = due[message.info().sequence];
      one.message = message;
      one.is_own |= is_own;
    }
  }
  for (auto& [sequence, one] : due) {
    if (!dds_writer.has_begun && !is_late && sequence > dds_writer.newest + 1) return;
    if (dds_writer.has_begun && !one.is_own) continue;
    dds_writer.has_begun |= one.is_own;
    if (dds_writer.is_newer(one.message.info()))
      dds_writer.waited.push_back(std::move(one.message));
  }
  end_waiting_if([&](const Waiting& key, const Queue&) { return key.first == publisher; });
}

void DdsWriters::write_soon(const std::shared_ptr<OpenDdsWriter>& dds_writer) {
  if (dds_writer->waited.empty() || dds_writer->is_held) return;
  opener_.add([this, dds_writer] { return write_waited(*dds_writer); });
  dds_writer->is_held = true;
}

// One at a time: a writer that waits for its readers delays the others only by that.
bool DdsWriters::write_waited(OpenDdsWriter& dds_writer) {
  GenericMessage message;
  {
    const std::lock_guard order(dds_writer.order);
    if (dds_writer.is_over) {
      dds_writer.traffic.unacknowledged += dds_writer.waited.size();
      dds_writer.waited.clear();
    }
    dds_writer.is_held = !dds_writer.waited.empty();
    if (!dds_writer.is_held) return false;
    message = dds_writer.waited.front();
  }
  bool is_written = true;
  try {
    is_written = write(dds_writer, message);
  } catch (const std::exception&) {
    ++dds_writer.traffic.refused;
  }
  const std::lock_guard order(dds_writer.order);
  if (is_written) dds_writer.waited.pop_front();
  return true;
}

void DdsWriters::end(std::shared_ptr<OpenDdsWriter> dds_writer) noexcept {
  dds_writer->is_over = true;
  deleter_.end(std::move(dds_writer));
}

void DdsWriters::close(std::uint64_t publisher) {
  const std::lock_guard lock(mutex_);
  if (const auto found = open_.find(publisher); found != open_.end()) {
    end(std::move(found->second));
    open_.erase(found);
  }
  ending_.erase(publisher);
}

void DdsWriters::close_all() {
  const std::lock_guard lock(mutex_);
  for (auto& [publisher, dds_writer] : open_) end(std::move(dds_writer));
  open_.clear();
  ending_.clear();
  without_.clear();
  end_waiting_if([](const Waiting&, const Queue&) { return true; });
}

void DdsWriters::close_later(std::uint64_t publisher, Time now) {
  const std::lock_guard lock(mutex_);
  if (open_.contains(publisher)) ending_.try_emplace(publisher, now + linger);
}

bool DdsWriters::tidy(Time now) {
  const std::lock_guard lock(mutex_);
  const auto is_late = [&](const Queue& queue) { return queue.since + linger < now; };
  std::set<std::uint64_t> behind_gaps;
  for (const auto& [key, queue] : waiting_) {
    if (is_late(queue) && open_.contains(key.first)) behind_gaps.insert(key.first);
  }
  for (const std::uint64_t publisher : behind_gaps) {
    const std::shared_ptr<OpenDdsWriter>& dds_writer = open_.at(publisher);
    // Its owner may be waiting for a reader in DDS: then try the next time.
    const std::unique_lock order(dds_writer->order, std::try_to_lock);
    if (!order) continue;
    catch_up(*dds_writer, publisher, true);
    write_soon(dds_writer);
  }
  std::erase_if(ending_, [&](const auto& entry) {
    if (entry.second > now) return false;
    std::shared_ptr<OpenDdsWriter>& dds_writer = open_.at(entry.first);
    if (const std::unique_lock order(dds_writer->order, std::try_to_lock);
        order && !dds_writer->has_begun) {
      catch_up(*dds_writer, entry.first, true);
      write_soon(dds_writer);
    }
    if (dds_writer->is_held && entry.second + held_linger > now) return false;
    end(std::move(dds_writer));
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

std::set<ReaderKey> DdsWriters::lingering() const {
  const std::lock_guard lock(mutex_);
  std::set<ReaderKey> keys;
  for (const auto& [publisher, end] : ending_) keys.insert(open_.at(publisher)->plan.local_reader);
  return keys;
}

void DdsWriters::forget_waiting(const ReaderKey& local_reader) {
  const std::lock_guard lock(mutex_);
  end_waiting_if([&](const Waiting& key, const Queue&) { return key.second == local_reader; });
}

void DdsWriters::set_without(std::set<std::uint64_t> publishers) {
  const std::lock_guard lock(mutex_);
  without_ = std::move(publishers);
  end_waiting_if([&](const Waiting& key, const Queue&) { return without_.contains(key.first); });
}

bool DdsWriters::write(OpenDdsWriter& dds_writer, const GenericMessage& message) const {
  const CdrType& type = dds_writer.type->cdr;
  // A publisher may let it refer to the heap of another one, whose messages may not be for DDS.
  const WindowSet within = windows_of(message);
  const std::size_t bytes = cdr_bytes(type, message.get(), &within);
  const auto written = dds_writer.writer->write(
      bytes,
      [&](std::span<std::byte> room) -> std::size_t {
        return write_cdr(type, message.get(), room, &within).value_or(0);
      },
      dds_writer.source_times.next(static_cast<std::int64_t>(message.info().source_timestamp())));
  if (written && *written == WriteOutcome::sent) {
    dds_writer.traffic.count(bytes);
    return true;
  }
  const bool would_block = written && *written == WriteOutcome::would_block;
  if (would_block && !dds_writer.is_over) {
    if (dds_writer.traffic.reports.now())
      log_.write(LogLevel::notice, "keep-all blocks a publisher",
                 {{"topic", dds_writer.plan.local_reader.of.key.topic},
                  {"node", dds_writer.plan.node},
                  {"why", "a reader in DDS does not acknowledge its messages"}});
    return false;
  }
  const std::uint64_t dropped =
      ++(would_block ? dds_writer.traffic.unacknowledged : dds_writer.traffic.refused);
  if (!dds_writer.traffic.reports.now()) return true;
  log_.write(LogLevel::warning, "message not written",
             {{"topic", dds_writer.plan.local_reader.of.key.topic},
              {"node", dds_writer.plan.node},
              {"sequence", std::to_string(message.info().sequence)},
              {"dropped", std::to_string(dropped)},
              {"why", !written      ? written.error().text()
                      : would_block ? "a reader in DDS does not acknowledge its messages"
                      : bytes == 0  ? "it refers to memory outside its publisher's"
                                   : "it cannot be written as CDR, or there is no memory for it"}});
  return true;
}

}  // namespace agnocast::bridge
