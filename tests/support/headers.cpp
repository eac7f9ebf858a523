// SPDX-License-Identifier: Apache-2.0
//
// Whose precompiled headers all tests, or all targets of a group, use; nothing runs it.

int main() {}
