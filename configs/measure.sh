#!/bin/sh
# A measurement campaign: whenever the FRF file of a job arrives, identify that job from it and say what was found.
#
# `lrbc watch CONFIG` does this and more, on every system. This script stays as an example of how a campaign of one's own is put together
# from the commands of lrbc: what they say for programs, what their exit codes mean.
#
#   sh configs/measure.sh CONFIG FOLDER [--once]
#
# CONFIG is the campaign file; it names one job a configuration of the bolts, and a job NAME is measured as FOLDER/NAME.uff
# (or .csv, .h5), whatever file its `frf:` names; jobs without a file there keep theirs. Files of other names are left alone.
# The script looks into the folder every two seconds until it is interrupted, or goes through it once. Gone through once, it
# exits with 5 where a file gave no result, else with 6 where a bolt is loose, else with 7 where not every bolt that can be
# seen is judged tight in every job, a file has no job's name, the calibration failed, or nothing but the tight state was
# measured, else with 0: all bolts are tight.
# lrbc keeps what is finished, so nothing is computed twice and the script may be stopped and started at any time.
set -u
config=${1:?usage: measure.sh CONFIG FOLDER [--once]}
folder=${2:?usage: measure.sh CONFIG FOLDER [--once]}
once=${3:-}
folder=$(cd "$folder" && pwd) || exit 2

# What lrbc says for programs is JSON, and text for people may change. Python reads it: any Python 3, which lrbc needs anyway,
# while jq is missing on many machines.
python=$(command -v python3 || command -v python) || {
    echo "measure.sh: no python3 on the PATH, to read what lrbc says" >&2
    exit 2
}
# json EXPRESSION [WORD]: the value of a Python expression of the document `tree` on stdin and of `word`; in UTF-8 whatever the locale.
json() {
    "$python" -c '
import json, os, sys
tree, word = json.loads(sys.stdin.buffer.read() or b"{}"), os.fsencode((sys.argv + [""])[2]).decode("utf-8", "replace")
sys.stdout.buffer.write(str(eval(sys.argv[1], {"tree": tree, "word": word})).encode("utf-8"))' "$@"
}

# Before the first hammer blow: the reduced model, once; and the names of the jobs.
lrbc reduce "$config" || exit $?
plan=$(lrbc update "$config" --dry-run --json) || exit $?
jobs=$(printf '%s' "$plan" | json '" ".join(name for name in tree["jobs"] if len(name.split()) == 1)') || exit 2
jobs=" $jobs "

# The job that the model is calibrated from, where the campaign says so.
tight=$(lrbc calibrate "$config" --dry-run --json 2> /dev/null | json 'tree.get("job", "")')

# The override that gives a job its file, quoted for YAML.
frf_of() {
    printf "jobs.%s.frf='%s'" "$1" "$(printf '%s' "$2" | sed "s/'/''/g")"
}

# 5 comes before 6, 6 before 7, 7 before 0.
alarm=0
worse() {
    if [ "$alarm" = 0 ] || [ "$1" -lt "$alarm" ]; then alarm=$1; fi
}

clear=no
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
            echo "$name: no job of this campaign has this name; left alone, so it clears nothing"
            worse 7
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
        calibrated=yes
        [ -z "$tight" ] || lrbc calibrate "$config" "$@" || { echo "not calibrated, see the message above"; calibrated=no; worse 7; }
        found=$(lrbc update "$config" --job "$job" "$@" --fail-on-loose --json)
        code=$?
        said=$(printf '%s' "$found" | json 'tree.get("findings", {}).get(word, "no result")' "$job") || exit 2
        case $code in
            0)   if [ $calibrated = yes ]; then
                     echo "$job: all bolts tight, go on ($said)"; clear=yes
                 else
                     echo "$job: NO ALL-CLEAR: $said, but with a model that is not calibrated"
                 fi ;;
            6)   echo "$job: A BOLT IS LOOSE: $said"; worse 6 ;;
            7)   # A tight state is nothing to clear; all else that is open is.
                 open=$(printf '%s' "$found" |
                     json '"; ".join("%s: %s" % (k, ", ".join(v)) for k, v in tree["not_clear"].items() if k)') || exit 2
                 if [ -n "$open" ]; then
                     echo "$job: NO ALL-CLEAR: $open"; worse 7
                 else
                     echo "$job: $said; verdicts given before it was measured rest on the tight state as it was then"
                 fi ;;
            3)   echo "$job: the file cannot be used, measure again"; worse 5 ;;
            4|5) echo "$job: no result, see the message above"; worse 5 ;;
            130) exit 130 ;;
            *)   echo "$job: stopped"; exit 2 ;;
        esac
        fresh=yes
    done
    if [ $fresh = yes ]; then
        lrbc report "$config" --quiet > /dev/null || echo "no report, see the message above"
    fi
    if [ "$once" = "--once" ]; then
        # Where nothing was compared with the tight state, nothing is clear.
        [ $clear = yes ] || worse 7
        exit "$alarm"
    fi
    sleep 2
done
