// SPDX-License-Identifier: Apache-2.0
//
// A system: one way to carry messages from a process to others on this host, including the
// floors.
//
// A run starts one process with a Sender and several with a Receiver each; the lane (lane.hpp)
// paces them and stores the times. Every payload begins with its number (eight bytes) and is
// written to its last byte, and a receiver verifies all of it; both happen outside the measured
// span.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bench {

/// Data for both sides of a run.
struct Carriage {
  std::string topic;          ///< used by this run only
  std::size_t bytes = 1024;   ///< of each payload, at least 16
  std::size_t receivers = 1;  ///< processes
  std::size_t index = 0;      ///< of this receiver
  std::size_t depth = 10;     ///< keep-last, reliable
  /// Zeroed part of the lane, shared by all processes of a run: floors keep their words and rings
  /// there.
  void* scratch = nullptr;
  std::size_t scratch_bytes = 0;
  /// Inherited by all; System::descriptors() makes them before the start: eventfds of floors.
  std::vector<int> descriptors;
};

class Sender {
 public:
  virtual ~Sender() = default;
  /// Returns whether all receivers would get a message sent now. Called every few milliseconds
  /// before a run.
  virtual bool is_matched() = 0;
  /// Borrows a message and returns its payload, writable, Carriage::bytes long; null if there is
  /// none now. Not measured.
  virtual std::byte* prepare() = 0;
  /// Publishes the prepared message: the measured call. Returns false if it was not sent.
  virtual bool send() = 0;
};

class Receiver {
 public:
  /// The payload is valid until this returns.
  using OnMessage = std::function<void(const std::byte* payload, std::size_t bytes)>;
  virtual ~Receiver() = default;
  /// Receives until stop(); the receiver is ready when its maker returns. Calls `on_message` once
  /// it has the message, in the thread of the system.
  virtual void run(const OnMessage& on_message) = 0;
  /// Makes run() return soon. From another thread.
  virtual void stop() = 0;
};

struct System {
  /// As in the results, e.g. "iceoryx-listener".
  std::string_view name;
  std::string_view summary;
  /// Makers in the role's process. Throw std::runtime_error with the error and the remedy.
  std::unique_ptr<Sender> (*make_sender)(const Carriage&);
  std::unique_ptr<Receiver> (*make_receiver)(const Carriage&);
  /// A service that must run first, by name ("agnocastd", "iox-roudi"); empty: none.
  std::string_view service;
  /// Returns "NAME=value" for its processes (LD_PRELOAD, CYCLONEDDS_URI). May be null.
  std::vector<std::string> (*environment)();
  /// Its receivers never sleep: each needs a core.
  bool is_spinning = false;
  /// Makes descriptors that all its processes inherit, in the conductor. May be null.
  std::vector<int> (*descriptors)(const Carriage&) = nullptr;
  /// Returns the path of the program that has its makers and the roles of role.cpp, built from the
  /// same sources; here its makers are null. Null: this program.
  std::string (*program)() = nullptr;
  /// Sender and receiver are threads of one process, and the sender's processor time includes the
  /// receiver's.
  bool is_one_process = false;
};

/// Returns all systems of this build, in the order of the tables. absent() has those without
/// their library.
const std::vector<System>& systems();
/// Returns "iceoryx: libiceoryx-posh-dev was not installed when this was built", …
std::vector<std::string> absent();

// One file of systems/ each; empty if the library is missing.
std::vector<System> floor_systems();
std::vector<System> agnocast_systems();
std::vector<System> cyclonedds_systems();
std::vector<System> iceoryx_systems();

}  // namespace agnocast::bench
