"""Newtons as they come: force with its standard deviation, where it presses, and what must not be believed.

python print_forces.py [FRAMES]   (the only sensor there is, or the one that RUFFINI_PORT names)
"""

import itertools
import sys

import ruffini

N_FRAMES = int(sys.argv[1]) if len(sys.argv) > 1 else None

with ruffini.connect(depth=0, on_note=print) as sensor:
    print(f"{sensor.serial_number}: {', '.join(sensor.boards)}")
    for frame in itertools.islice(sensor.frames(), N_FRAMES):
        if not frame.is_valid:  # its numbers would be NaN
            print(frame.number, "no force:", *frame.flags)
            continue
        wrench, contacts = frame.wrench, frame.contacts
        sigma = "not stated" if wrench.sigma is None else f"{wrench.sigma[:3].round(3)} N"
        places = [tuple(round(1e3 * c, 1) for c in contact.center) for contact in contacts.contacts] if contacts else []
        print(frame.number, f"{wrench.force.round(3)} N, sigma {sigma}, contacts at {places} mm",
              "SIMULATED" if frame.is_simulated else "")  # fmt: skip
