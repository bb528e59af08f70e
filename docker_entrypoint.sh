#!/bin/bash
# Run a command as the first process of a container. The kernel kills all processes of a container
# when the first one ends: so this one passes signals on and outlives the command for long enough
# that the sentinel can zero the coils of a driver that was killed.
setup=${MICROBOT_SETUP:-/workspace/install/setup.bash}
[ -f "$setup" ] && source "$setup"

"$@" <&0 &
command=$!
# They all mean the same to the command, and bash lets what runs in the background ignore SIGINT.
trap 'kill -TERM $command 2>/dev/null' INT TERM HUP

# A trapped signal ends `wait` early.
wait $command
status=$?
while kill -0 $command 2>/dev/null; do
    wait $command
    status=$?
done
sleep 0.5
exit $status
