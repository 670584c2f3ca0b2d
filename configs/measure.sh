#!/bin/sh
# A measurement campaign: whenever the FRF file of a job arrives, identify that job from it and say what was found.
#
#   sh configs/measure.sh CONFIG FOLDER [--once]
#
# CONFIG is the campaign file; it names one job a configuration of the bolts, and a job NAME is measured as FOLDER/NAME.uff
# (or .csv, .h5), whatever file its `frf:` names; jobs without a file there keep theirs. Files of other names are left alone.
# The script looks into the folder every two seconds until it is interrupted, or goes through it once. Gone through once, it
# exits with 6 where a bolt is loose, with 5 where a file gave no result, else with 0.
# lrbc keeps what is finished, so nothing is computed twice and the script may be stopped and started at any time.
set -u
config=${1:?usage: measure.sh CONFIG FOLDER [--once]}
folder=${2:?usage: measure.sh CONFIG FOLDER [--once]}
once=${3:-}
folder=$(cd "$folder" && pwd) || exit 2

# Before the first hammer blow: the reduced model, once; and the names of the jobs.
lrbc reduce "$config" || exit $?
plan=$(lrbc update "$config" --dry-run) || exit $?
jobs=" $(printf '%s\n' "$plan" | sed -n -e 's/: runs (.*//p' -e 's/: kept (.*//p' | tr '\n' ' ')"

# The job that the model is calibrated from, where the campaign says so.
tight=$(lrbc calibrate "$config" --dry-run 2> /dev/null | sed -n 's/^calibration from \(.*\): [rk][a-z]* (.*/\1/p')

# The override that gives a job its file, quoted for YAML.
frf_of() {
    printf "jobs.%s.frf='%s'" "$1" "$(printf '%s' "$2" | sed "s/'/''/g")"
}

alarm=0
seen=" "
while :; do
    fresh=no
    for file in "$folder"/*.uff "$folder"/*.csv "$folder"/*.h5; do
        [ -f "$file" ] || continue
        name=$(basename "$file"); job=${name%.*}
        stamp="$name:$(cksum < "$file" | tr ' ' '-')"
        case $seen in *" $stamp "*) continue ;; esac
        seen="$seen$stamp "
        case $job in *" "*) known=no ;; *) case $jobs in *" $job "*) known=yes ;; *) known=no ;; esac ;; esac
        if [ $known = no ]; then
            echo "$name: no job of this campaign has this name; left alone"
            continue
        fi

        # Verdicts compare with the reference job: it, too, is measured here. The new file comes last, and counts.
        set --
        for other in "$folder"/*.uff "$folder"/*.csv "$folder"/*.h5 "$file"; do
            earlier=$(basename "$other"); earlier=${earlier%.*}
            [ -f "$other" ] || continue
            case $earlier in *" "*) continue ;; esac
            case $jobs in *" $earlier "*) set -- "$@" --override "$(frf_of "$earlier" "$other")" ;; esac
        done
        # Again only where the tight state was measured anew.
        [ -z "$tight" ] || lrbc calibrate "$config" "$@" || echo "not calibrated, see the message above"
        lrbc update "$config" --job "$job" "$@" --fail-on-loose
        case $? in
            0)   echo "$job: all bolts tight, go on" ;;
            6)   echo "$job: A BOLT IS LOOSE, see the table above"; [ "$alarm" = 5 ] || alarm=6 ;;
            3)   echo "$job: the file cannot be used, measure again"; alarm=5 ;;
            4|5) echo "$job: no result, see the message above"; alarm=5 ;;
            130) exit 130 ;;
            *)   echo "$job: stopped" ; exit 2 ;;
        esac
        fresh=yes
    done
    if [ $fresh = yes ]; then
        lrbc report "$config" --quiet > /dev/null || echo "no report, see the message above"
    fi
    [ "$once" = "--once" ] && exit $alarm
    sleep 2
done
