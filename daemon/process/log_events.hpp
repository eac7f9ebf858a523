// SPDX-License-Identifier: Apache-2.0
//
// Log events: the ids by which the systemd journal knows them (MESSAGE_ID=). `journalctl
// MESSAGE_ID=…` finds all events of a kind, `journalctl -x` prints the explanation in
// systemd/agnocast.catalog.
#pragma once

#include <base/text/log.hpp>

#include <string_view>

namespace agnocast::daemon {

struct LogEvent {
  std::string_view words;
  std::string_view id;  // 32 hexadecimal digits; never given to another event
};

/// Events of level info or above. Events of level debug have no id.
inline constexpr LogEvent log_events[] = {
    {"a descriptor was lost", "9566a3435c504d32bf679fca282f9adf"},
    {"addresses blocked", "3fe6cd7de60b4f68932a873979a59776"},
    {"announcement waits", "6f3cdf5166714bd1be3b1a6d69cc96a3"},
    {"cannot supervise", "9b6ad1f4d8894cfaa9e9a31d567f287c"},
    {"client gone", "9ab7f407bfc04e79acdae747fa61751a"},
    {"client lost", "8119847262ef4d259a2192e904c0bbf2"},
    {"client revoked", "6fca436675da4304bb1b871fe8fa311f"},
    {"connection ended", "a71de3e96d2246dabd16b8bdcfee1ebf"},
    {"connection not accepted", "27e99203caa74883bf9f6865d3f74968"},
    {"connection refused", "f293b5a756fb48bb907ea588c5bbf38a"},
    {"connections cannot be closed", "1b7bb3d60f6a4d3f9f5a3c8a9d1f0e62"},
    {"ended", "60d7ecdaceba42408c20a0b8bbdd44be"},
    {"previous incarnation lost", "ccdb380e6819433a99791b402f556608"},
    {"heap collides", "e399c03f351f47adbe3e416341c34637"},
    {"holes are allowed", "5d0e3a7c9b1f4c62a8d4e6f70b2c9135"},
    {"lines were lost", "17e8216904f14e70a3823c0797ab2d44"},
    {"log level", "f91f871a15c74c3599d9aa8d26c70a1a"},
    {"memory not backed", "ba768a8ce2214841879d8a4f83a5d082"},
    {"more of the same was left out", "748a560f005945caa7f2a7a5792078a9"},
    {"no window is free in all processes", "5c779c1dbeb14411b7141d1b70cc3f05"},
    {"nothing is kept", "3eb879ce4a3042deb2b51e9e64a82d02"},
    {"notification passed over", "05e614c0755c43d8b0ba4ee9380ee271"},
    {"reader served again", "c2d91b7e3f604a8896e5d0471ab3f62c"},
    {"reader withdrawn", "4a8b0f6d2c5e4d0fa3b7c91e5f8d6027"},
    {"readers have changed", "061c9fa1b59e469e9ec8b3a63b7ffe76"},
    {"ready", "a0421a3bc2964e2f8aa193f2eb5d1a13"},
    {"refusing everybody", "323e33dd8c6e40b698d644ea08e5bc17"},
    {"request refused", "b4760de87e594896b2668c9cb15cc6c2"},
    {"resumed", "05d69499462a470e87a27dbd299b2cf0"},
    {"socket is not as configured", "ef622ed1bf8e45c0af693c21b427b79c"},
    {"socket made anew", "0352ee882f214b36af230d4e47a4199a"},
    {"socket stays where it is", "4612acacc05f428abfc139a305009208"},
    {"thread rule not applied", "13b55c3fed8044a192d0eb714a779fc3"},
    {"worker died", "7a6b53ead2ae4009bcff371590aa91c2"},
    {"worker does not end", "09ef10406e2e4183a96df6a9ac633331"},
    {"worker killed", "c0a4d1b6b24f4b0f9e0b6a4f3d7c5e18"},
    {"worker not started", "b5db630c364342d9bc9e90f21c4ed58b"},
};

/// Returns the id of an event; empty when it has none.
constexpr std::string_view message_id_of(std::string_view words) noexcept {
  for (const LogEvent& event : log_events) {
    if (event.words == words) return event.id;
  }
  return {};
}

/// The daemon as its log names it.
inline constexpr Log::Program log_program{"agnocastd", message_id_of};

}  // namespace agnocast::daemon
