#!/bin/sh
# As much of dfu-util 0.11 as `sutura flash` uses.
echo "dfu-util $*" >> "$FAKE_BOARD/log"
if [ "$1" = -l ]; then
    echo "dfu-util 0.11"
    if [ -e "$FAKE_BOARD/loader" ]; then
        found='Found DFU: [0483:df11] ver=2200, devnum=9, cfg=1, intf=0, path="1-4"'
        echo "$found, alt=3, name=\"@Device Feature/0xFFFF0000/01*004 e\", serial=\"345F37823336\""
        echo "$found, alt=0, name=\"@Internal Flash  /0x08000000/04*016Kg,01*064Kg,$(cat "$FAKE_BOARD/loader")\", serial=\"345F37823336\""
    fi
    # A board that the system keeps from this user.
    [ -e "$FAKE_BOARD/denied" ] && echo "dfu-util: Cannot open DFU device 0483:df11 found on devnum 9 (LIBUSB_ERROR_ACCESS)" >&2
    # A console that was asked to leave comes back as the loader.
    [ -e "$FAKE_BOARD/comes" ] && mv "$FAKE_BOARD/comes" "$FAKE_BOARD/loader"
    exit 0
fi
if [ ! -e "$FAKE_BOARD/loader" ]; then
    echo "dfu-util: No DFU capable USB device available" >&2
    exit 74
fi
while [ $# -gt 0 ]; do
    case "$1" in
        -s) memory="$2"; shift ;;
        -D | -U) way="$1"; file="$2"; shift ;;
    esac
    shift
done
offset=$((${memory%%:*} - 0x08000000))
case "$way" in
    -U)
        [ -e "$file" ] && exit 73
        flash-model read "$offset" "${memory#*:}" "$file"
        ;;
    -D)
        downloads=$(grep -c -e ' -D ' "$FAKE_BOARD/log")
        if [ "$(cat "$FAKE_BOARD/cut" 2> /dev/null)" = "$downloads" ]; then
            FAKE_COUNT=$(($(wc -c < "$file") / 2)) flash-model write "$offset" "$file"
            rm "$FAKE_BOARD/loader"
            echo "dfu-util: lost the board" >&2
            exit 74
        fi
        flash-model write "$offset" "$file"
        ;;
esac
