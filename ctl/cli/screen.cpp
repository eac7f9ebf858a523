// SPDX-License-Identifier: Apache-2.0

#include <ctl/cli/screen.hpp>

// Functions instead of macros, so that their names can be qualified.
#define NCURSES_NOMACROS 1
#include <curses.h>
#include <unistd.h>

#include <cstdio>

namespace agnocast::ctl {

// newterm() reports an unknown TERM; initscr() would end the program.
Screen::Screen() {
  SCREEN* const screen = ::newterm(nullptr, stdout, stdin);
  if (screen == nullptr) return;
  screen_ = screen;
  works_ = true;
  ::cbreak();
  ::noecho();
  ::curs_set(0);
  ::keypad(stdscr, TRUE);
  ::nodelay(stdscr, TRUE);
  ::set_escdelay(25);
}

Screen::~Screen() {
  if (!works_) return;
  ::endwin();
  ::delscreen(static_cast<SCREEN*>(screen_));
}

void Screen::draw(const std::vector<Line>& lines) {
  ::erase();
  const int height = LINES, width = COLS;
  for (int i = 0; i < height && static_cast<std::size_t>(i) < lines.size(); ++i) {
    const Line& line = lines[static_cast<std::size_t>(i)];
    if (line.strong) ::attron(A_BOLD);
    ::mvaddnstr(i, 0, line.text.c_str(), width);
    if (line.strong) ::attroff(A_BOLD);
  }
  ::refresh();
}

char Screen::key() {
  const int key = ::getch();
  return key > 0 && key < 128 ? static_cast<char>(key) : '\0';
}

int Screen::height() const { return LINES; }

std::string Screen::ask(std::string_view question) {
  std::string word;
  ::nodelay(stdscr, FALSE);
  for (;;) {
    ::move(LINES - 1, 0);
    ::clrtoeol();
    ::mvaddnstr(LINES - 1, 0, (std::string(question) + word).c_str(), COLS);
    ::refresh();
    const int key = ::getch();
    if (key == '\n' || key == KEY_ENTER || key == ERR) break;
    if (key == 27) {
      word.clear();
      break;
    }
    if (key == KEY_BACKSPACE || key == 127 || key == 8) {
      if (!word.empty()) word.pop_back();
    } else if (key >= ' ' && key < 127) {
      word += static_cast<char>(key);
    }
  }
  ::nodelay(stdscr, TRUE);
  return word;
}

}  // namespace agnocast::ctl
