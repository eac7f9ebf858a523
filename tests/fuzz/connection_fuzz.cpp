// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever an agnocastd says (a newer one, or none at all), the library's end of the connection
// neither crashes nor believes it: an answer reaches the request whose id it has, once, and nothing
// that is shorter than its header or longer than it says comes through.
// Method: the input is a list of packets; the fuzzer is the daemon at the other end of a socket pair.
// What a Context makes of a well-formed packet is not part of this.

#include <client/connection.hpp>

#include <fuzzer/FuzzedDataProvider.h>

#include <cstdlib>
#include <cstring>
#include <map>
#include <vector>

namespace {

using namespace agnocast;
namespace wire = abi::wire;

void require(bool condition) {
  if (!condition) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzedDataProvider input(data, size);
  auto ends = PacketSocket::pair();
  require(ends.has_value());
  Connection connection(std::move(ends->first));
  const PacketSocket& daemon = ends->second;
  Incoming packet;

  const bool first = input.ConsumeBool();
  if (first) {
    const auto bytes =
        input.ConsumeBytes<std::uint8_t>(input.ConsumeIntegralInRange<std::size_t>(1, 1100));
    if (!bytes.empty()) {
      (void)!daemon.send(std::as_bytes(std::span(bytes)));
      if (connection.receive_first(packet)) require(packet.size >= sizeof(wire::Header));
    }
  }
  // A few requests whose answers are waited for, by ids from 2 on.
  std::map<std::uint64_t, int> answered;
  const std::uint64_t asked = input.ConsumeIntegralInRange<std::uint64_t>(0, 4);
  for (std::uint64_t i = 0; i < asked; ++i) {
    connection.request_later(wire::Opcode::open_window, wire::WindowRequest{},
                             [&answered, i](Result<Incoming*> answer) {
                               ++answered[i];
                               if (!answer) {
                                 require(answer.error().what != nullptr);
                                 return;
                               }
                               wire::WindowOpened opened{};
                               if ((*answer)->read(opened))
                                 require((*answer)->size == sizeof opened);
                             });
  }
  bool alive = true;
  for (int i = 0; i < 64 && alive && input.remaining_bytes() > 0; ++i) {
    std::vector<std::uint8_t> bytes;
    if (input.ConsumeBool()) {
      bytes = input.ConsumeBytes<std::uint8_t>(input.ConsumeIntegralInRange<std::size_t>(1, 1100));
    } else {
      // A whole packet with a header that is right but for what the input says.
      const std::size_t sizes[] = {sizeof(wire::Header),          sizeof(wire::Refused),
                                   sizeof(wire::WindowOpened),    sizeof(wire::Announcement),
                                   sizeof(wire::WindowAnnounced), sizeof(wire::Notice)};
      bytes.resize(sizes[input.ConsumeIntegralInRange<std::size_t>(0, std::size(sizes) - 1)]);
      const auto body = input.ConsumeBytes<std::uint8_t>(
          input.ConsumeIntegralInRange<std::size_t>(0, bytes.size()));
      std::copy(body.begin(), body.end(), bytes.begin());
      wire::Header header{};
      header.opcode = input.ConsumeBool() ? wire::Opcode::refused
                                          : wire::Opcode{input.ConsumeIntegral<std::uint32_t>()};
      header.bytes = static_cast<std::uint32_t>(bytes.size()) -
                     (input.ConsumeIntegralInRange(0, 15) == 0 ? 1u : 0u);
      header.request = input.ConsumeIntegralInRange<std::uint64_t>(0, 6);
      std::memcpy(bytes.data(), &header, sizeof header);
    }
    if (bytes.empty()) break;
    const int fds[] = {daemon.fd(), daemon.fd(), daemon.fd()};
    (void)!daemon.send(std::as_bytes(std::span(bytes)),
                       std::span(fds).first(input.ConsumeIntegralInRange<std::size_t>(0, 3)));
    for (bool unasked = true; unasked && alive;) {
      const auto received = connection.receive(packet, unasked);
      alive = received && *received;
      if (alive && unasked) {
        require(packet.header().request == 0 && packet.header().bytes == packet.size);
        wire::Announcement announcement{};
        require(packet.read(announcement) == (packet.size == sizeof announcement));
      }
    }
  }
  connection.fail_all();
  for (const auto& [request, times] : answered) require(times == 1);
  return 0;
}
