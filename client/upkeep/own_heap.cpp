// SPDX-License-Identifier: Apache-2.0

#include <client/upkeep/own_heap.hpp>

#include <base/text/text.hpp>
#include <client/heap/heap_return.hpp>
#include <client/process/steps.hpp>

#include <cstdlib>
#include <new>
#include <string_view>
#include <utility>

namespace agnocast {

namespace wire = abi::wire;
using wire::Opcode;

namespace {

/// A user who starts a set-uid program controls its environment, so such a program ignores it.
Result<HeapScope> scope_from_environment(HeapScope otherwise) {
  const char* const text = ::secure_getenv("AGNOCAST_SCOPE");
  if (text == nullptr || *text == '\0') return otherwise;
  const std::string_view word = text;
  if (word == "loan") return HeapScope::loan;
  if (word == "all") return HeapScope::all;
  return fail_with(Errc::invalid_argument,
                   "AGNOCAST_SCOPE is " + in_quotes(text) + ", which is neither loan nor all");
}

}  // namespace

Result<void> OwnHeap::set_scope(HeapScope scope) noexcept {
  const std::lock_guard lock(opening_);
  if (is_open_.load(std::memory_order_relaxed) && scope != scope_)
    return fail(Errc::invalid_argument, "the scope of an open heap cannot be changed");
  scope_ = scope;
  return {};
}

Result<void> OwnHeap::open(Connection& connection, std::byte* client_region,
                           void (*grown)() noexcept, bool by_copy) {
  const std::lock_guard lock(opening_);
  if (is_open_.load(std::memory_order_relaxed)) return {};
  Result<Heap> found = Heap::find();
  if (!found) return tl::unexpected<Failure>(found.error());
  if (found->copies() && !by_copy) return Heap::missing_hook();
  const Result<HeapScope> scope = scope_from_environment(scope_);
  if (!scope) return tl::unexpected<Failure>(scope.error());
  const auto idle_time = HeapReturn::idle_time();
  if (!idle_time) return tl::unexpected<Failure>(idle_time.error());
  wire::WindowRequest request{};
  request.window = 0;
  Result<void> opened =
      connection.request(Opcode::open_window, request, [&](Incoming& packet) -> Result<void> {
        wire::WindowOpened window{};
        if (Result<void> read =
                packet.read_as(Opcode::window_opened, window, 2, "the answer with a heap window");
            !read)
          return read;
        const auto fds = packet.packet.fds();
        return found->attach(client_region, window.base, window.bytes, std::move(fds[0]),
                             fds[1].get(), *scope, grown);
      });
  if (!opened) return opened;
  heap_ = *found;
  scope_ = *scope;
  is_open_.store(true, std::memory_order_release);
  if (*idle_time) HeapReturn::instance().begin(heap_->hook(), **idle_time);
  return {};
}

void OwnHeap::continue_from(OwnHeap& former) {
  growth_.hold_back();
  const std::lock_guard lock(former.opening_);
  scope_ = former.scope_;
  heap_ = former.heap_;
  is_open_.store(former.is_open(), std::memory_order_release);
}

// The windows and their contents stay at their addresses: the new daemon is notified of them.
Result<void> OwnHeap::bring(Connection& connection, std::byte* client_region) {
  if (!is_open()) return {};
  if (!Heap::follow(client_region))
    return fail(Errc::limit_reached, "too many previous sessions are still in use");
  for (std::uint64_t i = 0; i < Heap::window_count(); ++i) {
    const Heap::Window window = Heap::window(i);
    wire::BringWindow body{};
    body.window = i;
    body.base = window.base;
    body.bytes = window.length;
    body.first = window.first;
    AGNOCAST_CRASH_POINT(C_bring);
    Result<void> brought = connection.request(
        Opcode::bring_window, body, [](Incoming&) { return Result<void>(); }, nullptr, false,
        window.write_fd);
    AGNOCAST_CRASH_POINT(C_brought);
    if (!brought) return brought;
  }
  growth_.bring(Heap::window_count());
  return {};
}

// Until the answer comes, or after a refusal, the heap uses the windows it has.
void OwnHeap::ask_for_window(Connection& connection, std::byte* client_region) {
  if (!is_open() || !growth_.may_ask() ||
      !growth_.is_due(HeapGrowth::Clock::now(), heap_->wants_window()))
    return;
  wire::WindowRequest request{};
  request.window = growth_.window_count();
  const auto on_answer = [this, client_region](Result<Incoming*> answer) {
    // The process has all windows that it may have, so no other answer will come.
    if (!answer && answer.error().code == Errc::window_exhausted) return heap_->no_more_windows();
    if (!answer || !add_window(**answer, client_region))
      return growth_.refused(HeapGrowth::Clock::now());
    if (growth_.opened()) heap_->no_more_windows();
  };
  growth_.asked();
  try {
    connection.request_later(Opcode::open_window, request, on_answer);
  } catch (const std::bad_alloc&) {
    growth_.not_asked();
    throw;
  }
}

bool OwnHeap::add_window(Incoming& answer, std::byte* client_region) noexcept {
  wire::WindowOpened opened{};
  if (!answer.read(opened) || answer.packet.descriptor_count != 2) return false;
  if (opened.window != growth_.window_count()) return false;
  // The daemon announces it to all other processes. Added before use, so that no reader waits for
  // it.
  peers_.add_own_window({opened.window, opened.base, opened.bytes, opened.first});
  const auto fds = answer.packet.fds();
  return heap_
      ->add_window(client_region, opened.window, opened.base, opened.bytes, std::move(fds[0]),
                   fds[1].get(), opened.first == opened.window)
      .has_value();
}

}  // namespace agnocast
