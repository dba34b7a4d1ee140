#!/bin/sh
# `synchronizar serve` with recordings in /rooms: it goes on with the rooms that this container recorded before.
set -eu
if [ -n "$(ls "$XDG_STATE_HOME/synchronizar/rooms" 2> /dev/null)" ]; then
  set -- --resume "$@"
fi
exec synchronizar serve --record /rooms "$@"
