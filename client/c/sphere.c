/* A soft sphere on a console: sphere PORT [SECONDS]
 *
 * `sutura console --link /tmp/console` makes a virtual console to try it on; a scripted hand then presses into the sphere
 * from above. On a console with motors the hand is yours, and the sphere is under the middle of its travel. */

#include "sutura.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The top of the sphere is the origin. */
static const float MIDDLE_M[3] = {0.0f, 0.0f, -0.05f};
static const float RADIUS_M = 0.05f;
static const float STIFFNESS_N_PER_M = 400.0f;

/* Force along the outward normal n: k (R - d), d from the middle. From there it changes by -k n n' along the normal, and
 * across it by F/d (I - n n'), because the normal turns. */
static sutura_contact sphere(const float grip_m[3])
{
    sutura_contact contact;
    float away[3], square = 0.0f, distance, push;
    int i, j;

    memset(&contact, 0, sizeof contact);
    for (i = 0; i < 3; i++) {
        away[i] = grip_m[i] - MIDDLE_M[i];
        square += away[i] * away[i];
    }
    distance = fmaxf(sqrtf(square), 1e-6f);
    push = STIFFNESS_N_PER_M * fmaxf(RADIUS_M - distance, 0.0f);
    contact.gap_m = fmaxf(distance - RADIUS_M, 0.0f);
    for (i = 0; i < 3; i++) {
        contact.normal[i] = away[i] / distance;
        contact.force_n[i] = push * contact.normal[i];
    }
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 3; j++) {
            float along = contact.normal[i] * contact.normal[j];
            float across = (i == j ? 1.0f : 0.0f) - along;
            contact.tangent[i][j] = push / distance * across - STIFFNESS_N_PER_M * along;
        }
    }
    return contact;
}

static int failed(const char *what)
{
    fprintf(stderr, "%s: %s\n", what, sutura_last_error());
    return EXIT_FAILURE;
}

int main(int argc, char **argv)
{
    /* From 10 mm above the sphere to 10 mm below its top, and a little aside. */
    static const sutura_way_point path[2] = {{0.0f, {0.0f, 0.0f, 0.01f}}, {0.5f, {0.004f, 0.0f, -0.01f}}};
    double seconds = argc > 2 ? atof(argv[2]) : 3.0;
    sutura_console *console;
    sutura_info info;
    sutura_pose pose;
    uint64_t start_us = 0, shown_us = 0;
    int32_t code;

    if (argc < 2) {
        fprintf(stderr, "usage: sphere PORT [SECONDS]\n");
        return 2;
    }
    if (sutura_open(argv[1], NULL, &console) != SUTURA_OK) {
        return failed("open");
    }
    if (sutura_read_info(console, &info) != SUTURA_OK) {
        return failed("info");
    }
    printf("%s, %d Hz, %s\n", info.name, info.tick_hz, info.simulated ? "simulated" : "motors");
    if (info.simulated && sutura_set_hand(console, 1000.0f, 10.0f, path, 2) != SUTURA_OK) {
        return failed("hand");
    }
    if (sutura_arm(console) != SUTURA_OK) {
        return failed("arm");
    }
    while ((code = sutura_read_pose(console, 500, &pose)) >= 0) {
        sutura_contact contact;

        if (code == SUTURA_NO_POSE) {
            fprintf(stderr, "nothing came from the console for half a second\n");
            continue;
        }
        contact = sphere(pose.position_m);
        if (sutura_send_contact(console, &pose, &contact) != SUTURA_OK) {
            return failed("contact");
        }
        if (start_us == 0) {
            start_us = pose.time_us;
        }
        /* Mode, place [m], force felt [N], force of the sphere there [N]. */
        if (pose.time_us >= shown_us + 50000) {
            shown_us = pose.time_us;
            printf("%u  %.6f %.6f %.6f  %.4f %.4f %.4f  %.4f %.4f %.4f\n", (unsigned)pose.mode, pose.position_m[0],
                   pose.position_m[1], pose.position_m[2], pose.force_n[0], pose.force_n[1], pose.force_n[2],
                   contact.force_n[0], contact.force_n[1], contact.force_n[2]);
            fflush(stdout);
        }
        if ((double)(pose.time_us - start_us) > 1e6 * seconds) {
            break;
        }
    }
    if (code < 0) {
        failed("pose");
        sutura_close(console);
        return EXIT_FAILURE;
    }
    return sutura_close(console) == SUTURA_OK ? EXIT_SUCCESS : failed("close");
}
