// SPDX-License-Identifier: Apache-2.0
//
// Goal: a filter accepts the messages that its expression describes; an expression that does not
// fit the type is refused with the position of the error. Method: expressions over one message.

#include <ctl/messages/filter.hpp>
#include <tests/unit/ctl/made_message.hpp>

#include <gmock/gmock.h>
#include <agnocast_test_msgs/msg/everything.hpp>

#include <cmath>
#include <limits>
#include <string>

namespace agnocast::ctl {
namespace {

using agnocast_test_msgs::msg::Everything;

test::Made<Everything> message() {
  test::Made<Everything> made;
  made->text = "it's \"top\"";
  made->wide = u"w\u00e9";
  made->flags = {true, false};
  made->fixed_flags = {true, false, true, false};
  made->numbers = {0.1, std::nan(""), std::numeric_limits<double>::infinity()};
  made->fixed_numbers[3] = 200;
  made->bounded_numbers = {-5};
  made->inner.label = "in";
  made->fixed_flats[1].x = 0.5F;
  return made;
}

TEST(Filter, AcceptsMessagesForWhichItsExpressionHolds) {
  const auto of = message();
  for (const char* const holds : {"true",
                                  "not false",
                                  "m.flags[0]",
                                  "not m.flags[1]",
                                  "m.fixed_flags[2]",
                                  "m.flags[0] == true",
                                  "m.fixed_numbers[3] == 200",
                                  "msg.fixed_numbers[3] > 199.5",
                                  "m.bounded_numbers[0] < 0",
                                  "m.bounded_numbers[0] == -5",
                                  "-5 == m.bounded_numbers[0]",
                                  "m.numbers[0] == 0.1",
                                  "m.numbers[2] > 1e300",
                                  "m.numbers[1] != m.numbers[1]",
                                  "not (m.numbers[1] == 1)",
                                  "m.fixed_flats[1].x == .5",
                                  "m.inner.label == \"in\"",
                                  "m.inner.label == 'in'",
                                  "m.text == 'it\\'s \"top\"'",
                                  "m.wide == 'w\xc3\xa9'",
                                  "m.inner.label < 'io'",
                                  "len(m.flags) == 2",
                                  "len(m.text) == 10",
                                  "len( m.inner.label )>1",
                                  "len(m.wide) == 2",
                                  "false or true",
                                  "true or false and false",
                                  "(false or true) and true",
                                  "not false and true",
                                  "not (true and false)",
                                  "  true\t",
                                  "((((true))))",
                                  "m.flags[0]and m.flags[0]",
                                  "not m.numbers[9] == 1"}) {
    const auto filter = Filter::parse(holds, of.type().members());
    ASSERT_TRUE(filter) << holds << ": " << filter.error().why;
    EXPECT_TRUE(filter->accepts(of.value())) << holds;
  }
  for (const char* const does_not :
       {"false", "m.numbers[9] == 1", "m.numbers[9] != 1", "m.flags[7]",
        "m.numbers[1] == m.numbers[1]", "(true or false) and false", "m.text == 'top'",
        "m.flags[1] or m.flags[1]"}) {
    const auto filter = Filter::parse(does_not, of.type().members());
    ASSERT_TRUE(filter) << does_not << ": " << filter.error().why;
    EXPECT_FALSE(filter->accepts(of.value())) << does_not;
  }
}

TEST(Filter, ComparesWholeNumbersOf64BitsExactly) {
  const IntrospectedType type = find_message_type("std_msgs/msg/UInt64");
  const OwnedGenericMessage made = type.make();
  *reinterpret_cast<std::uint64_t*>(made.get()) = 18446744073709551615U;
  const auto accepts = [&](const std::string& text) {
    return Filter::parse(text, type.members())->accepts(Value::of(type.members(), made.get()));
  };
  EXPECT_TRUE(accepts("m.data == 18446744073709551615"));
  EXPECT_FALSE(accepts("m.data == 18446744073709551614"));
}

TEST(Filter, IsRefusedWithThePositionOfTheError) {
  const auto& members = test::Made<Everything>::type().members();
  for (const auto& [text, why] : std::initializer_list<std::pair<std::string, const char*>>{
           {"", "character 1 of \"\": a number, a text, a field or '(' is missing"},
           {"m.text = 'a'", "character 8 of \"m.text = 'a'\": write == for equality"},
           {"m.text", "character 1 of \"m.text\": a text is not a condition"},
           {"3", "character 1 of \"3\": a number is not a condition"},
           {"m.text == 3",
            "character 8 of \"m.text == 3\": a text cannot be compared with a number"},
           {"m.flags[0] == 1",
            "character 12 of \"m.flags[0] == 1\": a truth value cannot be compared with a number"},
           {"m.flags == 1",
            "character 1 of \"m.flags == 1\": bool[] cannot be compared; name one of its fields"},
           {"m == 1", "character 1 of \"m == 1\": write a field as m.name"},
           {"text == 'a'",
            "character 1 of \"text == 'a'\": write a field as m.name, a text in quotes"},
           {"m.text == 'a", "character 13 of \"m.text == 'a\": the closing quote is missing"},
           {"(true", "character 6 of \"(true\": ')' is missing"},
           {"true true", "character 6 of \"true true\": the end is expected here"},
           {"not 3", "character 5 of \"not 3\": a number is not a condition"},
           {"true and 3", "character 10 of \"true and 3\": a number is not a condition"},
           {"1 or true", "character 1 of \"1 or true\": a number is not a condition"},
           {"1 < 2 < 3", "character 7 of \"1 < 2 < 3\": the end is expected here"},
           {"len(m.inner) > 1",
            "character 1 of \"len(m.inner) > 1\": agnocast_test_msgs/msg/Inner has no length"}}) {
    const auto filter = Filter::parse(text, members);
    ASSERT_FALSE(filter) << text;
    EXPECT_EQ(filter.error().what, "--filter");
    EXPECT_EQ(filter.error().why, why);
    EXPECT_EQ(filter.error().status, Status::wrong_usage);
  }
  const auto unknown = Filter::parse("m.inner.lable == 'x'", members);
  ASSERT_FALSE(unknown);
  EXPECT_THAT(unknown.error().why, testing::HasSubstr("has no field \"lable\""));
  for (const std::string& deep : {std::string(100000, '('), [] {
                                    std::string text;
                                    for (int i = 0; i < 50000; ++i) text += "not ";
                                    return text + "true";
                                  }()})
    EXPECT_THAT(Filter::parse(deep, members).error().why, testing::HasSubstr("too deep"));
}

}  // namespace
}  // namespace agnocast::ctl
