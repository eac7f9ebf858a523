// SPDX-License-Identifier: Apache-2.0
//
// Samples: messages with their bytes on the wire. Ours are in tests/golden, made by encode.py;
// those recorded from ROS 2 in the folder AGNOCAST_GOLDEN_CDR_DIR, if there is one.
#pragma once

#include <agnocast/generic.hpp>
#include <tests/support/schema_tables.hpp>

#include <nlohmann/json.hpp>

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace agnocast::test {

using Bytes = std::vector<std::byte>;

struct Sample {
  std::string file;
  nlohmann::json json;

  std::string text(const char* key) const { return json.at(key).get<std::string>(); }
  Schema schema() const { return json.at("schema").get<Schema>(); }
};

std::filesystem::path own_samples();
/// Returns an empty path if there is no folder of recorded samples.
std::filesystem::path recorded_samples();
/// Returns every *.json of both folders that has `key`.
std::vector<Sample> samples_with(const char* key);

Bytes bytes_of_hex(const std::string& hex);
std::string hex_of(std::span<const std::byte> bytes);

/// Sets every member. Throws the exception of nlohmann::json if the value is not of this type, and
/// std::runtime_error if it lacks a member or has an extra one.
void set_message(const MessageMembers& members, const nlohmann::json& value, void* message);

}  // namespace agnocast::test
