// SPDX-License-Identifier: Apache-2.0

#include <base/text/text.hpp>
#include <ctl/cli/unicode.hpp>
#include <ctl/messages/filter.hpp>

#include <charconv>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace agnocast::ctl {
namespace {

enum class Kind : std::uint8_t { nothing, boolean, number, text };

// The value of an expression for one message; only the member of its kind is used.
struct Operand {
  Kind kind = Kind::nothing;  // nothing: a missing element
  bool boolean = false;
  // Holds every 64-bit integer: 64 bits of mantissa on x86-64, 113 on AArch64.
  long double number = 0;
  std::string text = {};

  static Operand of(bool value) { return {Kind::boolean, value}; }
  static Operand of(long double value) { return {Kind::number, false, value}; }
  static Operand of(std::string value) { return {Kind::text, false, 0, std::move(value)}; }
};

template <class T>
bool compare(const T& a, std::string_view sign, const T& b) {
  if (sign == "==") return a == b;
  if (sign == "!=") return a != b;
  if (sign == "<=") return a <= b;
  if (sign == ">=") return a >= b;
  return sign == "<" ? a < b : a > b;
}
bool holds(const Operand& a, std::string_view sign, const Operand& b) {
  if (a.kind == Kind::nothing || b.kind == Kind::nothing) return false;
  if (a.kind == Kind::boolean) return compare(a.boolean, sign, b.boolean);
  return a.kind == Kind::number ? compare(a.number, sign, b.number) : compare(a.text, sign, b.text);
}

const char* name_of(Kind kind) {
  return kind == Kind::boolean ? "a truth value" : kind == Kind::number ? "a number" : "a text";
}

Kind kind_of(const Shape& scalar) {
  if (scalar.is_text()) return Kind::text;
  return scalar.is_boolean() ? Kind::boolean : Kind::number;
}

// Texts are compared as bytes; a wide text that is not valid Unicode equals nothing.
Operand operand_of(const Scalar& scalar) {
  return std::visit(
      [](const auto& value) -> Operand {
        using T = std::decay_t<decltype(value)>;
        if constexpr (std::is_same_v<T, bool>) {
          return Operand::of(value);
        } else if constexpr (std::is_same_v<T, std::string_view>) {
          return Operand::of(std::string(value));
        } else if constexpr (std::is_same_v<T, std::u16string_view>) {
          const auto letters = from_utf16(value);
          if (!letters) return {};
          std::string text;
          for (const char32_t letter : *letters) append_utf8(text, letter);
          return Operand::of(std::move(text));
        } else {
          return Operand::of(static_cast<long double>(value));
        }
      },
      scalar);
}

}  // namespace

struct Filter::Node {
  Kind kind = Kind::boolean;
  std::function<Operand(const Value&)> value;

  bool is_true(const Value& message) const { return value(message).boolean; }
};

namespace {

// Bound for nested parentheses and `not`.
constexpr int depth_max = 100;

struct Wrong {
  std::size_t at;
  std::string why;
};

class Parser {
 public:
  Parser(std::string_view text, const MessageMembers& type) : text_(text), type_(type) {}

  Filter::Node all() {
    Filter::Node node = expression();
    skip_blanks();
    if (at_ != text_.size()) refuse("the end is expected here");
    return boolean(std::move(node), 0);
  }

 private:
  using Node = Filter::Node;

  [[noreturn]] void refuse(std::string why) const { throw Wrong{at_, std::move(why)}; }
  [[noreturn]] static void refuse_at(std::size_t at, std::string why) {
    throw Wrong{at, std::move(why)};
  }

  static bool is_name_letter(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
  }
  void skip_blanks() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\t')) ++at_;
  }
  std::string_view rest() const { return text_.substr(at_); }
  bool take(std::string_view symbol) {
    skip_blanks();
    if (!rest().starts_with(symbol)) return false;
    at_ += symbol.size();
    return true;
  }
  bool take_word(std::string_view word) {
    skip_blanks();
    if (!rest().starts_with(word)) return false;
    if (rest().size() > word.size() && is_name_letter(rest()[word.size()])) return false;
    at_ += word.size();
    return true;
  }

  static Node boolean(Node node, std::size_t at) {
    if (node.kind != Kind::boolean)
      refuse_at(at, std::string(name_of(node.kind)) + " is not a condition");
    return node;
  }

  template <class Both>
  Node joined(Node first, std::size_t first_at, std::string_view word, Node (Parser::*next)(),
              Both both) {
    while (take_word(word)) {
      skip_blanks();
      const std::size_t at = at_;
      Node a = boolean(std::move(first), first_at), b = boolean((this->*next)(), at);
      first = {Kind::boolean,
               [a, b, both](const Value& message) { return Operand::of(both(a, b, message)); }};
    }
    return first;
  }
  Node expression() {
    if (++depth_ > depth_max) refuse("too deep");
    skip_blanks();
    const std::size_t at = at_;
    Node node = joined(conjunction(), at, "or", &Parser::conjunction,
                       [](const Node& a, const Node& b, const Value& message) {
                         return a.is_true(message) || b.is_true(message);
                       });
    --depth_;
    return node;
  }
  Node conjunction() {
    skip_blanks();
    const std::size_t at = at_;
    return joined(negation(), at, "and", &Parser::negation,
                  [](const Node& a, const Node& b, const Value& message) {
                    return a.is_true(message) && b.is_true(message);
                  });
  }
  Node negation() {
    if (!take_word("not")) return comparison();
    if (++depth_ > depth_max) refuse("too deep");
    skip_blanks();
    const std::size_t at = at_;
    Node inner = boolean(negation(), at);
    --depth_;
    return {Kind::boolean,
            [inner](const Value& message) { return Operand::of(!inner.is_true(message)); }};
  }

  Node comparison() {
    Node left = operand();
    skip_blanks();
    const std::size_t at = at_;
    // Longer signs first.
    static constexpr std::string_view signs[] = {"==", "!=", "<=", ">=", "<", ">"};
    for (const std::string_view sign : signs) {
      if (!take(sign)) continue;
      Node right = operand();
      if (left.kind != right.kind)
        refuse_at(at, std::string(name_of(left.kind)) + " cannot be compared with " +
                          name_of(right.kind));
      return {Kind::boolean, [left, right, sign](const Value& message) {
                return Operand::of(holds(left.value(message), sign, right.value(message)));
              }};
    }
    if (rest().starts_with("=")) refuse("write == for equality");
    return left;
  }

  Node operand() {
    skip_blanks();
    if (at_ == text_.size()) refuse("a number, a text, a field or '(' is missing");
    const std::size_t at = at_;
    if (take("(")) {
      Node inner = expression();
      if (!take(")")) refuse("')' is missing");
      return inner;
    }
    if (take_word("true") || take_word("True")) return constant(Operand::of(true));
    if (take_word("false") || take_word("False")) return constant(Operand::of(false));
    if (take_word("len")) {
      if (!take("(")) refuse("'(' is missing");
      const Path path = place();
      if (!path.shape().is_array && !path.shape().is_text())
        refuse_at(at, path.shape().type_name() + " has no length");
      if (!take(")")) refuse("')' is missing");
      return {Kind::number, [path](const Value& message) -> Operand {
                const auto found = path.in(message);
                if (!found) return {};
                if (found->shape().is_array)
                  return Operand::of(static_cast<long double>(found->size()));
                return std::visit(
                    [](const auto& value) -> Operand {
                      if constexpr (requires { value.size(); }) {
                        return Operand::of(static_cast<long double>(value.size()));
                      } else {
                        return {};
                      }
                    },
                    found->scalar());
              }};
    }
    if (text_[at_] == '"' || text_[at_] == '\'') return text();
    if (text_[at_] == '-' || text_[at_] == '+' || text_[at_] == '.' ||
        (text_[at_] >= '0' && text_[at_] <= '9'))
      return number();
    const Path path = place();
    if (!path.shape().is_scalar())
      refuse_at(at, path.shape().type_name() + " cannot be compared; name one of its fields");
    return {kind_of(path.shape()), [path](const Value& message) {
              const auto found = path.in(message);
              return found ? operand_of(found->scalar()) : Operand();
            }};
  }

  static Node constant(Operand operand) {
    const Kind kind = operand.kind;
    return {kind, [operand = std::move(operand)](const Value&) { return operand; }};
  }

  Node number() {
    const bool is_negative = rest().starts_with('-');
    if (is_negative || rest().starts_with('+')) ++at_;
    // Whole numbers are exact; others are rounded to float64, or no field would ever equal them.
    const char* const first = text_.data() + at_;
    const char* const end = text_.data() + text_.size();
    std::uint64_t whole = 0;
    double real = 0;
    const auto as_whole = std::from_chars(first, end, whole);
    const auto as_real = std::from_chars(first, end, real);
    if (as_real.ec != std::errc()) refuse("this is not a number");
    const bool is_whole = as_whole.ec == std::errc() && as_whole.ptr == as_real.ptr;
    const long double value = is_whole ? static_cast<long double>(whole) : real;
    at_ = static_cast<std::size_t>(as_real.ptr - text_.data());
    return constant(Operand::of(is_negative ? -value : value));
  }

  // In quotes of either kind; a backslash takes the next character literally.
  Node text() {
    const char quote = text_[at_++];
    std::string value;
    for (;; ++at_) {
      if (at_ == text_.size()) refuse("the closing quote is missing");
      if (text_[at_] == quote) break;
      if (text_[at_] == '\\' && at_ + 1 < text_.size()) ++at_;
      value += text_[at_];
    }
    ++at_;
    return constant(Operand::of(std::move(value)));
  }

  Path place() {
    skip_blanks();
    const std::size_t at = at_;
    if (!take_word("msg") && !take_word("m")) refuse("write a field as m.name, a text in quotes");
    const std::size_t first = at_;
    const auto belongs_to_it = [&] {
      const char letter = text_[at_];
      if (letter == '.' || letter == '[' || letter == ']') return true;
      return is_name_letter(letter) && text_[at_ - 1] != ']';
    };
    while (at_ < text_.size() && belongs_to_it()) ++at_;
    if (first == at_ || text_[first] != '.') refuse_at(at, "write a field as m.name");
    auto path = Path::parse(text_.substr(first + 1, at_ - first - 1), type_);
    if (!path) refuse_at(at, path.error().what + ": " + path.error().why);
    return std::move(*path);
  }

  const std::string_view text_;
  const MessageMembers& type_;
  std::size_t at_ = 0;
  int depth_ = 0;
};

}  // namespace

Filter::Filter(std::unique_ptr<const Node> root) noexcept : root_(std::move(root)) {}
Filter::Filter(Filter&&) noexcept = default;
Filter& Filter::operator=(Filter&&) noexcept = default;
Filter::~Filter() = default;

Outcome<Filter> Filter::parse(std::string_view text, const MessageMembers& type) {
  try {
    return Filter(std::make_unique<Node>(Parser(text, type).all()));
  } catch (const Wrong& wrong) {
    return problem(
        Status::wrong_usage, "--filter",
        "character " + std::to_string(wrong.at + 1) + " of " + in_quotes(text) + ": " + wrong.why,
        "agnocast-ctl topic echo /chatter --filter 'm.data == \"hello\" or len(m.data) > 10'");
  }
}

bool Filter::accepts(const Value& message) const { return root_->is_true(message); }

}  // namespace agnocast::ctl
