// SPDX-License-Identifier: Apache-2.0
//
// Mdoc: text in mdoc(7), for the programs that write manual pages at build time.
#pragma once

#include <string>
#include <string_view>

namespace agnocast::mdoc {

/// Escapes text to print it literally: a backslash begins an escape, a dot a macro.
std::string plain(std::string_view text);
/// Wraps text into short lines; each sentence begins one.
std::string lines_of(std::string_view text);
/// Returns the beginning of a page. `date` in mdoc's form: "November 21, 2026".
std::string heading(std::string_view title, std::string_view section, std::string_view does,
                    std::string_view date);
/// Returns the head of an option's item: "Fl n , Fl Fl number" for "-n,--number".
std::string flags_of(std::string_view names);

}  // namespace agnocast::mdoc
