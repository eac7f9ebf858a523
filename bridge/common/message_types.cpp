// SPDX-License-Identifier: Apache-2.0

#include <bridge/common/message_types.hpp>

#include <chrono>

namespace agnocast::bridge {
namespace {

// How long a missing type is not searched again.
constexpr std::chrono::seconds missing_for(10);

}  // namespace

std::optional<std::string> MessageTypes::problem_of(const std::string& type) {
  if (types_.contains(type)) return std::nullopt;
  const Time now = std::chrono::steady_clock::now();
  const auto missing = missing_.find(type);
  if (missing != missing_.end() && missing->second.since + missing_for > now)
    return missing->second.why;
  const auto found = try_find_message_type(type, paths_);
  const auto cdr = found ? CdrType::of(found->members()) : tl::unexpected<Failure>(found.error());
  if (!cdr) {
    missing_[type] = {text_of(cdr.error()), now};
    return text_of(cdr.error());
  }
  missing_.erase(type);
  types_[type] = std::make_shared<const BridgedType>(BridgedType{*found, *cdr});
  return std::nullopt;
}

}  // namespace agnocast::bridge
