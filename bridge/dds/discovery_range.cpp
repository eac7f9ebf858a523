// SPDX-License-Identifier: Apache-2.0

#include <base/text/text.hpp>
#include <bridge/dds/discovery_range.hpp>

#include <unistd.h>

#include <algorithm>
#include <string_view>
#include <vector>

namespace agnocast::bridge {
namespace {

constexpr const char* localhost_only_variable = "ROS_LOCALHOST_ONLY";
constexpr const char* range_variable = "ROS_AUTOMATIC_DISCOVERY_RANGE";
constexpr const char* peers_variable = "ROS_STATIC_PEERS";

// Without multicast each participant has its own well-known ports, and searches those of this many
// on each peer. As in rmw_cyclonedds_cpp, whose nodes must look as far as we do.
constexpr int participants_of_a_peer = 32;

/// A host name, an IPv4 or an IPv6 address, with a port if need be: nothing that XML gives a
/// meaning to.
bool is_address(std::string_view text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
           std::string_view(".:-_[]%").find(c) != std::string_view::npos;
  });
}

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  for (std::size_t begin = 0; begin <= text.size();) {
    const std::size_t end = std::min(text.find(separator, begin), text.size());
    if (end > begin) parts.push_back(text.substr(begin, end - begin));
    begin = end + 1;
  }
  return parts;
}

std::string domain_with(const std::string& general, const std::string& discovery) {
  std::string text = "<CycloneDDS><Domain>";
  if (!general.empty()) text += "<General>" + general + "</General>";
  if (!discovery.empty()) text += "<Discovery>" + discovery + "</Discovery>";
  return text + "</Domain></CycloneDDS>";
}

std::string searching(const std::vector<std::string>& peers) {
  std::string text = "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>" +
                     std::to_string(participants_of_a_peer) + "</MaxAutoParticipantIndex>";
  if (peers.empty()) return text;
  text += "<Peers>";
  for (const std::string& peer : peers) text += "<Peer address=\"" + peer + "\"/>";
  return text + "</Peers>";
}

}  // namespace

tl::expected<DiscoveryRange, DiscoveryRangeError> discovery_range(
    const std::function<std::string(const char*)>& variable) {
  const std::string distribution = variable("ROS_DISTRO");
  const bool is_localhost_only = variable(localhost_only_variable) == "1";
  const std::string set = std::string(localhost_only_variable) + "=1";
  if (is_localhost_only && (distribution.empty() || distribution <= "humble")) {
    return DiscoveryRange{
        domain_with("<Interfaces><NetworkInterface address=\"127.0.0.1\"/></Interfaces>", ""), set};
  }
  std::string range = variable(range_variable);
  if (is_localhost_only) range = "LOCALHOST";
  const std::string reason = is_localhost_only ? set : std::string(range_variable) + '=' + range;
  std::vector<std::string> peers;
  if (!is_localhost_only) peers = split(variable(peers_variable), ';');
  for (const std::string& peer : peers) {
    if (!is_address(peer))
      return tl::unexpected(DiscoveryRangeError{peers_variable, in_quotes(peer) + " is no address",
                                                "export ROS_STATIC_PEERS='192.168.0.1;robot2'"});
  }
  if (range.empty() || range == "SUBNET") {
    if (peers.empty()) return DiscoveryRange{};
    return DiscoveryRange{domain_with("", searching(peers)), ""};
  }
  const std::string no_multicast = "<AllowMulticast>false</AllowMulticast>";
  if (range == "SYSTEM_DEFAULT") return DiscoveryRange{};
  if (range == "LOCALHOST") {
    peers.insert(peers.begin(), "localhost");
    return DiscoveryRange{domain_with(no_multicast, searching(peers)), reason};
  }
  if (range == "OFF") {
    // A tag that no other participant has.
    return DiscoveryRange{
        domain_with(no_multicast, "<ParticipantIndex>none</ParticipantIndex><Tag>agnocast-bridge-" +
                                      std::to_string(::getpid()) + "</Tag>"),
        reason};
  }
  return tl::unexpected(DiscoveryRangeError{
      range_variable, in_quotes(range) + " is none of SUBNET, LOCALHOST, OFF and SYSTEM_DEFAULT",
      "export ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET"});
}

}  // namespace agnocast::bridge
