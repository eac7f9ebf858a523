// SPDX-License-Identifier: Apache-2.0
//
// Screen: a terminal whose lines are redrawn repeatedly. It hides all of ncurses.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {

class Screen {
 public:
  /// Takes over the terminal; the destructor restores it.
  Screen();
  ~Screen();
  Screen(const Screen&) = delete;
  Screen& operator=(const Screen&) = delete;

  /// Returns false when the terminal cannot be used (TERM unknown).
  bool works() const noexcept { return works_; }
  struct Line {
    std::string text;
    bool strong = false;
  };
  /// Draws the lines from the top, and cuts those that do not fit.
  void draw(const std::vector<Line>& lines);
  /// Returns the character of a key that was pressed, or 0; does not wait.
  char key();
  /// Returns the current number of lines.
  int height() const;
  /// Asks for a word on the last line. Enter ends it; Escape returns an empty word.
  std::string ask(std::string_view question);

 private:
  bool works_ = false;
  void* screen_ = nullptr;
};

}  // namespace agnocast::ctl
