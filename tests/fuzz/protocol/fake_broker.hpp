// SPDX-License-Identifier: Apache-2.0
//
// Fake broker: the daemon without sockets. It has the parts of the real one that decide about
// sessions and memory (registry, regions, address plan, obstacles, doorbells, endpoint manager),
// over real memory, and takes Broker's place around them: a packet comes from a Process and goes
// to a Process, and the oracle sees what is sent and the result of each request. It has no quotas
// and no access rules, which belong to Broker.
//
// Each input gets a new one.
#pragma once

#include <base/descriptors/unique_fd.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/state/address_plan.hpp>
#include <daemon/state/obstacles.hpp>

#include <tests/fuzz/protocol/oracle.hpp>
#include <tests/fuzz/protocol/processes.hpp>

#include <cstddef>
#include <cstdint>
#include <span>

namespace agnocast::daemon::fuzz {

/// The descriptor in a packet: the window at `base`, as a daemon made it for a user.
struct BroughtWindow {
  const UniqueFd* fd = nullptr;
  std::uint64_t base = 0;
  std::uint32_t uid = 0;
};

class FakeBroker final : public ClientChannel {
 public:
  FakeBroker();

  Processes& processes() { return processes_; }
  const Registry& registry() const { return registry_; }
  const AddressPlan& plan() const { return plan_; }
  Registry::Memory memory() const { return regions_.memory(); }
  /// Returns the region of a process, writable as for the process itself.
  std::byte* region(ClientIndex client) const { return regions_.region(client); }

  /// Serves a packet of a process, on its connection or on a new one.
  void serve(Process& from, std::span<const std::byte> packet, const Envelope& envelope = {},
             const BroughtWindow* brought = nullptr);
  /// Serves a packet of the observer.
  void serve_observer(std::span<const std::byte> packet);
  void accept_observer() { observer_ = Session(PacketSocket(), PeerIdentity{}); }
  /// Ends the process; another may take its place.
  void die(Process& process);

  // --- the client channel
  using ClientChannel::send;
  Session* session_of(ClientIndex client) override;
  std::uint64_t user_namespace_of(ClientIndex) override { return 1; }
  void send(ClientIndex client, Outgoing packet) override;
  void begin_anew(ClientIndex, std::string_view) override {}  // the notes never fill up here

 private:
  Process* process_of(ClientIndex client);
  void greet(Process& from, const wire::Hello& hello);
  journal::RejoinDecision decide(const Process& from, const wire::Rejoin& request);
  void rejoin(Process& from, const wire::Rejoin& request);
  void open_window(Process& from, const wire::WindowRequest& request);
  void bring_window(Process& from, const wire::BringWindow& request, const BroughtWindow& brought);
  void begin_window(Process& owner, const WindowRecord& window);
  void open_wait_set(const Process& from, const WaitSetRequest& request);
  void create(Process& from, const CreateRequest& request);
  void block(Process& from, const wire::Blocked& request);
  void revoke(const wire::Revoke& request);

  DescriptorStore store_;
  Regions regions_;
  Registry registry_;
  AddressPlan plan_;
  Obstacles obstacles_;
  Doorbells doorbells_;
  EndpointManager endpoint_manager_;
  Processes processes_;
  Oracle oracle_{processes_};
  Session observer_{PacketSocket(), PeerIdentity{}};
};

}  // namespace agnocast::daemon::fuzz
