#!/bin/sh
# Starts the fingers of a hand: five nodes, each in a namespace of its own, without launch files. Ctrl-C ends them all.
#
#     sh examples/five_fingers.sh                         # 50 Hz each
#     sh examples/five_fingers.sh -p dt:=0.01             # what follows goes to every node
#
# /thumb/command_pose drives the thumb, /thumb/device_wrench is felt there, and so on. Each has its own frames on /tf.
trap 'kill $(jobs -p) 2> /dev/null' INT TERM
for name in thumb index middle ring little; do
    finger_sim node --ros-args -r __ns:=/$name -p finger_frame:=$name -p dt:=0.02 -p realtime_priority:=0 "$@" &
done
# A signal ends the first wait; the second one lets every node close what it records.
wait
wait
