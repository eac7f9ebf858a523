// SPDX-License-Identifier: Apache-2.0

#include <bench/lane.hpp>

#include <linux/futex.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstring>
#include <new>
#include <stdexcept>

namespace agnocast::bench {
namespace {

constexpr std::size_t page = 4096;
constexpr std::uint32_t being_written = 1, written = 2;  // Head::has_error
constexpr std::size_t to_page(std::size_t bytes) { return (bytes + page - 1) / page * page; }

struct Places {
  std::size_t seen, sent, received, scratch, end;
};
Places places_of(const Plan& plan) {
  Places places{};
  places.seen = to_page(sizeof(Lane::Head));
  places.sent = places.seen + to_page(plan.receivers * sizeof(Lane::Seen));
  places.received = places.sent + to_page(plan.all_messages() * sizeof(Lane::Sent));
  places.scratch =
      places.received + to_page(plan.receivers * plan.all_messages() * sizeof(std::int64_t));
  places.end = places.scratch + Lane::scratch_bytes;
  return places;
}

std::byte expected_byte(std::uint64_t number, std::size_t page_index) noexcept {
  return static_cast<std::byte>((number * 31 + page_index * 7 + 1) & 0xff);
}

}  // namespace

std::int64_t now_ns() noexcept {
  timespec time{};
  ::clock_gettime(CLOCK_MONOTONIC, &time);
  return std::int64_t{1'000'000'000} * time.tv_sec + time.tv_nsec;
}

constexpr std::uint64_t meaning = 1;
const std::uint64_t Lane::layout =
    ((meaning * 4096 + sizeof(Head)) * 4096 + sizeof(Plan)) * 4096 + scratch_bytes / page;

Lane::Lane(const Plan& plan, std::string_view system, std::string_view topic)
    : descriptor_(::memfd_create("agnocast-bench", MFD_CLOEXEC)) {
  const std::size_t bytes = places_of(plan).end;
  if (descriptor_ < 0 || ::ftruncate(descriptor_, static_cast<off_t>(bytes)) != 0)
    throw std::runtime_error(std::string("memory for a run: ") + std::strerror(errno));
  map(bytes);
  head_ = new (base_) Head{};
  head_->layout = layout;
  head_->plan = plan;
  system.copy(head_->system, sizeof head_->system - 1);
  topic.copy(head_->topic, sizeof head_->topic - 1);
  place(plan);
}

Lane::Lane(int descriptor) : descriptor_(descriptor) {
  struct stat state {};
  if (::fstat(descriptor, &state) != 0)
    throw std::runtime_error("this role was not started by agnocast-bench");
  map(static_cast<std::size_t>(state.st_size));
  head_ = static_cast<Head*>(base_);
  if (bytes_ < sizeof(Head) || head_->layout != layout)
    throw std::runtime_error(
        "this program and agnocast-bench were built from different sources; build both again");
  place(head_->plan);
}

// Allocates all pages: no message includes a first touch.
void Lane::map(std::size_t bytes) {
  base_ = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, descriptor_, 0);
  if (base_ == MAP_FAILED)
    throw std::runtime_error(std::string("memory for a run: ") + std::strerror(errno));
  bytes_ = bytes;
}

void Lane::place(const Plan& plan) noexcept {
  const Places places = places_of(plan);
  auto* const bytes = static_cast<std::byte*>(base_);
  seen_ = reinterpret_cast<Seen*>(bytes + places.seen);
  sent_ = reinterpret_cast<Sent*>(bytes + places.sent);
  received_ = reinterpret_cast<std::int64_t*>(bytes + places.received);
  scratch_ = bytes + places.scratch;
}

Lane::~Lane() {
  ::munmap(base_, bytes_);
  ::close(descriptor_);
}

bool Lane::have_all_seen(std::uint64_t number) const noexcept {
  for (std::size_t i = 0; i < plan().receivers; ++i) {
    if (seen_[i].number.load(std::memory_order_acquire) < number) return false;
  }
  return true;
}

std::int64_t Lane::all_seen_ns() const noexcept {
  std::int64_t latest = 0;
  for (std::size_t i = 0; i < plan().receivers; ++i) latest = std::max(latest, seen_[i].at_ns);
  return latest;
}

void Lane::set_error(std::string_view text) noexcept {
  std::uint32_t none = 0;
  if (!head_->has_error.compare_exchange_strong(none, being_written)) return;
  text.copy(head_->error, sizeof head_->error - 1);
  head_->has_error.store(written, std::memory_order_release);
}

std::string Lane::error() const {
  return head_->has_error.load(std::memory_order_acquire) == written ? head_->error : std::string();
}

void Lane::set_state(State state) noexcept {
  head_->state.store(state, std::memory_order_release);
  ::syscall(SYS_futex, &head_->state, FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
}

void Lane::wait_while(State state) const noexcept {
  while (head_->state.load(std::memory_order_acquire) == state)
    ::syscall(SYS_futex, &head_->state, FUTEX_WAIT, state, nullptr, nullptr, 0);
}

void mark(std::byte* payload, std::size_t bytes, std::uint64_t number) noexcept {
  for (std::size_t at = 0; at < bytes; at += page)
    std::fill_n(payload + at, std::min(page, bytes - at), expected_byte(number, at / page));
  std::memcpy(payload, &number, sizeof number);
}

std::uint64_t number_of(const std::byte* payload) noexcept {
  std::uint64_t number = 0;
  std::memcpy(&number, payload, sizeof number);
  return number;
}

bool is_intact(const std::byte* payload, std::size_t bytes, std::uint64_t number) noexcept {
  if (number_of(payload) != number) return false;
  for (std::size_t at = 0; at < bytes; at += page) {
    const std::byte* const begin = payload + (at == 0 ? sizeof number : at);
    const std::byte* const end = payload + std::min(at + page, bytes);
    // If each byte equals its neighbour, all equal the first.
    const bool is_even =
        std::memcmp(begin, begin + 1, static_cast<std::size_t>(end - begin) - 1) == 0;
    if (*begin != expected_byte(number, at / page) || !is_even) return false;
  }
  return true;
}

}  // namespace agnocast::bench
