// SPDX-License-Identifier: Apache-2.0
//
// Screen: a terminal whose lines are replaced again and again. All of ncurses is behind this.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {

class Screen {
 public:
  /// Takes the terminal over; it is as before when this object ends.
  Screen();
  ~Screen();
  Screen(const Screen&) = delete;
  Screen& operator=(const Screen&) = delete;

  /// False when the terminal cannot be used (TERM unknown).
  bool works() const noexcept { return works_; }
  struct Line {
    std::string text;
    bool strong = false;
  };
  /// From the top; what does not fit is cut.
  void draw(const std::vector<Line>& lines);
  /// A key that was pressed, or 0; does not wait. Letters as they are.
  char key();
  /// How many lines it has now.
  int height() const;
  /// Asks for a word on the last line; ended by Enter, given up by Escape.
  std::string ask(std::string_view question);

 private:
  bool works_ = false;
  void* screen_ = nullptr;
};

}  // namespace agnocast::ctl
