// SPDX-License-Identifier: Apache-2.0
//
// A system: one way to carry messages from a process to others of this host. What is compared, and the floors.
//
// A run starts one process with a Sender and some with a Receiver each; the lane (lane.hpp) paces them and keeps the
// times. Every payload begins with its number (eight bytes) and is written to its last byte, and a receiver proves that it
// has all of it; both happen outside the measured span.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bench {

/// What both sides of a run know.
struct Carriage {
  std::string topic;                 ///< of this run alone
  std::size_t bytes = 1024;          ///< of each payload, at least 16
  std::size_t receivers = 1;         ///< processes
  std::size_t index = 0;             ///< of this receiver
  std::size_t depth = 10;            ///< keep-last, reliable
  /// Of the lane, zeroed, shared by all processes of a run: floors keep their words and rings there.
  void* scratch = nullptr;
  std::size_t scratch_bytes = 0;
  /// Inherited by all, made by System::descriptors() before they start: eventfds of floors.
  std::vector<int> descriptors;
};

class Sender {
 public:
  virtual ~Sender() = default;
  /// Whether all receivers would get what is sent now. Asked every few milliseconds before a run.
  virtual bool is_matched() = 0;
  /// Borrows a message and returns its payload, writable, Carriage::bytes long; null where there is none now. Not measured.
  virtual std::byte* prepare() = 0;
  /// The publish call for what was prepared: this is measured. False: not sent.
  virtual bool send() = 0;
};

class Receiver {
 public:
  /// The payload is good until this returns.
  using OnMessage = std::function<void(const std::byte* payload, std::size_t bytes)>;
  virtual ~Receiver() = default;
  /// Ready to receive as of the return of the maker. Calls `on_message` once the message is in hand, in whichever
  /// thread the system does so, until stop().
  virtual void run(const OnMessage& on_message) = 0;
  /// From another thread: run() returns soon.
  virtual void stop() = 0;
};

struct System {
  /// As in the results, e.g. "iceoryx-listener".
  std::string_view name;
  std::string_view summary;
  /// Makers in the role's process. Throw std::runtime_error with what is wrong and what to do.
  std::unique_ptr<Sender> (*make_sender)(const Carriage&);
  std::unique_ptr<Receiver> (*make_receiver)(const Carriage&);
  /// A service that must run first, by name ("agnocastd", "iox-roudi"); empty: none.
  std::string_view service;
  /// "NAME=value" for its processes (LD_PRELOAD, CYCLONEDDS_URI). May be null.
  std::vector<std::string> (*environment)();
  /// Its receivers never sleep: it needs a core for each.
  bool is_spinning = false;
  /// Descriptors that all its processes inherit, made by the conductor. May be null.
  std::vector<int> (*descriptors)(const Carriage&) = nullptr;
};

/// All that this build has, in the order of the tables. What is left out for want of a library is told by absent().
const std::vector<System>& systems();
/// "iceoryx: libiceoryx-posh-dev was not installed when this was built", …
std::vector<std::string> absent();

// One file of systems/ each; empty where the library is missing.
std::vector<System> floor_systems();
std::vector<System> agnocast_systems();
std::vector<System> cyclonedds_systems();
std::vector<System> iceoryx_systems();

}  // namespace agnocast::bench
