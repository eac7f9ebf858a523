// SPDX-License-Identifier: Apache-2.0
//
// Journal: the daemon's flight recorder, in words. Pure: turns a record with its names into text.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <journal/record.hpp>

#include <nlohmann/json_fwd.hpp>

#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {

namespace wire = abi::wire;

/// The records that the daemon sent to an observer, the oldest first.
struct Journal {
  std::vector<wire::JournalRecord> records;
  wire::JournalEnd end{};
};

/// Returns the subject of a record: "publisher 3 of /points (lidar, pid 812)".
std::string subject_of(const wire::JournalRecord& record);
/// Returns what was done: "ended with its process, last message rolled back".
std::string deed_of(const wire::JournalRecord& record);

/// Returns whether the record is damaged: only its number is valid then.
bool is_damaged(const wire::JournalRecord& record) noexcept;
/// Returns an argument by its name in journal/record.hpp; 0 if records of this type have none.
std::uint64_t argument(const wire::JournalRecord& record, std::string_view name) noexcept;
inline std::string text_of(const wire::Name& name) {
  return std::string(name.text, ::strnlen(name.text, sizeof name.text));
}

/// Selects records; an empty text selects all.
struct JournalFilter {
  std::string topic;    // its name
  std::string process;  // name or pid of the owner, the notified process or the reader
};
bool passes(const wire::JournalRecord& record, const JournalFilter& filter);

}  // namespace agnocast::ctl
