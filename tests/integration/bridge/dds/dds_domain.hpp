// SPDX-License-Identifier: Apache-2.0
//
// A DDS domain of one test: an id that no other test of this machine uses meanwhile, on the
// loopback device only; and the process on its other side.
#pragma once

#include <tests/integration/bridge/dds/dds_side.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <sys/socket.h>
#include <sys/un.h>

#include <cstdlib>
#include <memory>
#include <string>

namespace agnocast::test {

class Domain {
 public:
  Domain() {
    ::setenv("CYCLONEDDS_URI", configuration("10 s").c_str(), 1);
    // The process that binds the name has the id. Above 101 the ports would be those that Linux
    // assigns to clients.
    for (id_ = 1; id_ <= 101; ++id_) {
      taken_.reset(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
      sockaddr_un name{};
      name.sun_family = AF_UNIX;
      const std::string text = "agnocast-test-domain-" + std::to_string(id_);
      text.copy(name.sun_path + 1, text.size());
      const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + 1 + text.size());
      if (::bind(taken_.get(), reinterpret_cast<sockaddr*>(&name), size) == 0) return;
    }
    std::abort();
  }

  std::uint32_t id() const { return id_; }
  std::unique_ptr<DdsParticipant> participant() const {
    return std::move(DdsParticipant::create({.domain = id_}).value());
  }
  /// Starts the other side; others think it gone after `lease` without news.
  std::unique_ptr<SteeredProcess> peer(const std::string& lease = "10 s") const {
    return std::make_unique<SteeredProcess>(
        std::vector<std::string>{AGNOCAST_TEST_DDS_PEER, std::to_string(id_)},
        std::vector<std::string>{"CYCLONEDDS_URI=" + configuration(lease)});
  }

  /// Returns the text for CYCLONEDDS_URI; `more` are further elements.
  static std::string configuration(const std::string& lease, const std::string& more = "") {
    return "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\"/></Interfaces>"
           "</General><Discovery><LeaseDuration>" +
           lease + "</LeaseDuration></Discovery>" + more + "</Domain></CycloneDDS>";
  }

 private:
  std::uint32_t id_ = 0;
  UniqueFd taken_;
};

}  // namespace agnocast::test
