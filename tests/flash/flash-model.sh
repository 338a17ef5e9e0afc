#!/bin/sh
# The flash of an STM32F405 in $FAKE_BOARD/flash.bin: erase the sectors that a file lies in, and write it.
# flash-model write OFFSET FILE; flash-model read OFFSET LENGTH FILE
flash="$FAKE_BOARD/flash.bin"
offset=$(($2))
if [ "$1" = read ]; then
    tail -c "+$((offset + 1))" "$flash" | head -c "$3" > "$4"
    exit
fi
length=$(wc -c < "$3")
start=0
for kib in 16 16 16 16 64 128 128 128 128 128 128 128; do
    if [ "$start" -lt $((offset + length)) ] && [ $((start + kib * 1024)) -gt "$offset" ]; then
        head -c $((kib * 1024)) /dev/zero | tr '\000' '\377' |
            dd of="$flash" bs=1024 seek=$((start / 1024)) conv=notrunc iflag=fullblock 2> /dev/null
    fi
    start=$((start + kib * 1024))
done
count=$((${FAKE_COUNT:-$length}))
head -c "$count" "$3" | dd of="$flash" bs=1024 seek=$((offset / 1024)) conv=notrunc iflag=fullblock 2> /dev/null
# A byte that does not take what is written.
if [ -e "$FAKE_BOARD/worn" ]; then
    printf '\000' | dd of="$flash" bs=1 seek="$(cat "$FAKE_BOARD/worn")" conv=notrunc 2> /dev/null
fi
exit 0
