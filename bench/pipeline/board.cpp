// SPDX-License-Identifier: Apache-2.0

#include <bench/pipeline/board.hpp>

#include <base/clock.hpp>

#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <new>
#include <stdexcept>

namespace agnocast::bench::pipeline {
namespace {

static_assert(std::atomic<std::uint32_t>::is_always_lock_free);

[[noreturn]] void fail() {
  throw std::runtime_error(std::string("memory that the pipeline shares: ") + std::strerror(errno));
}

}  // namespace

Board::Board(std::size_t frames)
    : descriptor_(::memfd_create("agnocast-bench-pipeline", MFD_CLOEXEC)) {
  const std::size_t bytes = sizeof(Head) + frames * sizeof(Frame);
  if (descriptor_ < 0 || ::ftruncate(descriptor_, static_cast<off_t>(bytes)) != 0) fail();
  map(bytes);
  Head* const made = new (base_) Head{};
  made->frames = frames;
  for (sem_t* const semaphore :
       {&made->go[0], &made->go[1], &made->go[2], &made->done, &made->over})
    ::sem_init(semaphore, 1, 0);
  for (std::size_t i = 0; i < frames; ++i) new (frames_begin() + i) Frame;
}

Board::Board(Inherited from) : descriptor_(from.descriptor) {
  struct stat state {};
  if (::fstat(descriptor_, &state) != 0)
    throw std::runtime_error("this role was not started by agnocast-bench");
  map(static_cast<std::size_t>(state.st_size));
}

Board::~Board() {
  ::munmap(base_, bytes_);
  ::close(descriptor_);
}

// Allocates all pages: no frame includes a first touch.
void Board::map(std::size_t bytes) {
  base_ = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, descriptor_, 0);
  if (base_ == MAP_FAILED) fail();
  bytes_ = bytes;
}

Frame* Board::frames_begin() const noexcept {
  return reinterpret_cast<Frame*>(static_cast<std::byte*>(base_) + sizeof(Head));
}

void Board::set_error(std::string_view text) noexcept {
  if (head().has_error.exchange(1) != 0) return;
  text.copy(head().error, sizeof head().error - 1);
  head().has_error.store(2);
  ::sem_post(&head().done);
}

std::string Board::error() const { return head().has_error == 2 ? head().error : ""; }

void wait(sem_t& semaphore) noexcept {
  while (::sem_wait(&semaphore) != 0 && errno == EINTR) continue;
}

bool wait(sem_t& semaphore, std::int64_t at_most_ns) noexcept {
  const std::int64_t end_ns = static_cast<std::int64_t>(monotonic_ns()) + at_most_ns;
  const timespec end{static_cast<time_t>(end_ns / 1'000'000'000), end_ns % 1'000'000'000};
  int result = -1;
  do {
    result = ::sem_clockwait(&semaphore, CLOCK_MONOTONIC, &end);
  } while (result != 0 && errno == EINTR);
  return result == 0;
}

}  // namespace agnocast::bench::pipeline
