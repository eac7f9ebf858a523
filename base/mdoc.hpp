// SPDX-License-Identifier: Apache-2.0
//
// Mdoc: text as mdoc(7) has it, for the programs that write manual pages when the project is built.
#pragma once

#include <string>
#include <string_view>

namespace agnocast::mdoc {

/// Text as it is printed, whatever it has: a backslash begins an escape, a dot a macro.
std::string plain(std::string_view text);
/// Lines of text: a sentence begins one, none is long.
std::string lines_of(std::string_view text);
/// The beginning of a page. `date` as mdoc has it: "November 21, 2026".
std::string heading(std::string_view title, std::string_view section, std::string_view does,
                    std::string_view date);
/// The head of an item that is an option, "-n,--number" for example: "Fl n , Fl Fl number".
std::string flags_of(std::string_view names);

}  // namespace agnocast::mdoc
