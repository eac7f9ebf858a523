// SPDX-License-Identifier: Apache-2.0
//
// Journal: the daemon's flight recorder, in words. Pure: a record and its names in, a sentence out.
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

/// What an observer was sent of it, oldest first.
struct Journal {
  std::vector<wire::JournalRecord> records;
  wire::JournalEnd end{};
};

/// "publisher 3 of /points (lidar, pid 812)": what it is about.
std::string subject_of(const wire::JournalRecord& record);
/// "ended with its process, last message rolled back": what was done.
std::string deed_of(const wire::JournalRecord& record);

/// Nothing in it means anything, but its number.
bool is_damaged(const wire::JournalRecord& record) noexcept;
/// An argument by its name in journal/record.hpp; 0 when records of this type have none.
std::uint64_t argument(const wire::JournalRecord& record, std::string_view name) noexcept;
inline std::string text_of(const wire::Name& name) {
  return std::string(name.text, ::strnlen(name.text, sizeof name.text));
}

/// "12:01:33.120 #4711 publisher 3 of /points (lidar, pid 812): ended …": all of it.
std::string line_of(const wire::JournalRecord& record, const Journal& journal);
/// The same for programs.
nlohmann::ordered_json record_object(const wire::JournalRecord& record, const Journal& journal);
/// The clock, now: "12:01:33.120", and "2026-01-31T12:01:33.120Z".
std::string now_for_people();
std::string now_for_programs();

/// Which records somebody wants to see; empty texts: all.
struct JournalFilter {
  std::string topic;    // its name
  std::string process;  // its name or pid, as owner, or as the one that is told or reads
};
bool passes(const wire::JournalRecord& record, const JournalFilter& filter);

}  // namespace agnocast::ctl
