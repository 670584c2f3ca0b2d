#!/bin/sh
# A measurement campaign: whenever the FRF file of a job arrives, identify that job and say what was found.
#
#   sh configs/measure.sh CONFIG FOLDER [--once]
#
# CONFIG is the campaign file; it names one job a configuration of the bolts, and a job NAME is measured as FOLDER/NAME.uff
# (or .csv, .h5). The script looks into the folder every two seconds until it is interrupted, or goes through it once.
# Gone through once, it exits with 6 where a bolt is loose, with 5 where a file gave no result, else with 0.
# lrbc keeps what is finished, so nothing is computed twice and the script may be stopped and started at any time.
set -u
config=${1:?usage: measure.sh CONFIG FOLDER [--once]}
folder=${2:?usage: measure.sh CONFIG FOLDER [--once]}
once=${3:-}

# Before the first hammer blow: the reduced model, once.
lrbc reduce "$config" || exit $?

alarm=0
seen=" "
while :; do
    for file in "$folder"/*.uff "$folder"/*.csv "$folder"/*.h5; do
        [ -f "$file" ] || continue
        job=$(basename "$file"); job=${job%.*}
        stamp="$job:$(cksum < "$file" | tr ' ' '-')"
        case $seen in *" $stamp "*) continue ;; esac
        seen="$seen$stamp "

        lrbc update "$config" --job "$job" --fail-on-loose
        case $? in
            0)   echo "$job: all bolts tight, go on" ;;
            6)   echo "$job: A BOLT IS LOOSE, see the table above"; [ "$alarm" = 5 ] || alarm=6 ;;
            3)   echo "$job: the file cannot be used, measure again"; alarm=5 ;;
            4|5) echo "$job: no result, see the message above"; alarm=5 ;;
            130) exit 130 ;;
            *)   echo "$job: stopped" ; exit 2 ;;
        esac
        lrbc report "$config" --quiet > /dev/null || echo "$job: no report"
    done
    [ "$once" = "--once" ] && exit $alarm
    sleep 2
done
