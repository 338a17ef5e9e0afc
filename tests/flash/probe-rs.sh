#!/bin/sh
# As much of probe-rs as `sutura flash` uses.
echo "probe-rs $*" >> "$FAKE_BOARD/log"
command="$1"
shift
case "$command" in
    list)
        probe=$(cat "$FAKE_BOARD/probe")
        if [ -n "$probe" ]; then
            echo "The following debug probes were found:"
            echo "[0]: STLink V2-1 -- $probe (ST-LINK)"
        else
            echo "No debug probes were found."
        fi
        ;;
    read)
        shift 4
        if [ "$2" = 0xE0042000 ]; then
            echo "e0042000: $(cat "$FAKE_BOARD/id")"
        else
            flash-model read $(($2 - 0x08000000)) $(($3 * 4)) "$7"
        fi
        ;;
    download)
        flash-model write $((${8} - 0x08000000)) "${10}"
        ;;
esac
