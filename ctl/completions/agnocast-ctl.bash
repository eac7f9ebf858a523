# Completion of agnocast-ctl for bash: the program prints the words that may stand at the cursor.
_agnocast_ctl() {
  local IFS=$'\n'
  COMPREPLY=($(agnocast-ctl --complete "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null))
}
complete -F _agnocast_ctl agnocast-ctl
