#!/usr/bin/env python3
"""Holds `coordinator compare` against a second implementation: numpy, and the FLIP evaluator of FLIP's authors where it is installed.

    pip install numpy OpenEXR [flip-evaluator]
    python3 tests/image/compare_with_numpy.py PICTURE.exr REFERENCE.exr [--coordinator target/release/coordinator]

Prints every measure from both with their relative difference; exit code 1 when one differs by more than 1e-6.
"""

import argparse
import json
import subprocess
import sys

import numpy as np
import OpenEXR

TOLERANCE = 1e-6
RELATIVE_FLOOR = 0.01
TRIMMED_SHARE = 0.001


def read(path):
    """Pixels in f64, and what the file says of itself."""
    with OpenEXR.File(path) as file:
        channels = file.channels()
        rgb = channels["RGB"].pixels if "RGB" in channels else np.stack([channels[c].pixels for c in "RGB"], axis=-1)
        text = file.header().get("tessera", "{}")
    return rgb.astype(np.float64), json.loads(text.decode() if isinstance(text, bytes) else text)


def srgb_bytes(linear):
    linear = np.clip(linear.astype(np.float32), np.float32(0), np.float32(1)).astype(np.float64)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.floor(encoded * 255.0 + 0.5).astype(np.uint8)


def flip(picture, reference):
    """Mean FLIP of the 8-bit sRGB pictures; None where the evaluator is not installed."""
    try:
        import flip_evaluator
    except ImportError:
        return None
    prepared = [(srgb_bytes(x) / np.float32(255)).astype(np.float32) for x in (reference, picture)]
    error_map, _, _ = flip_evaluator.evaluate(*prepared, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False)
    return float(error_map.astype(np.float64).mean())


def measures(picture, reference, stated, same_seed):
    difference = picture - reference
    relative = (difference**2 / (reference**2 + RELATIVE_FLOOR)).mean(axis=-1).ravel()
    kept = np.sort(relative)[: relative.size - int(relative.size * TRIMMED_SHARE)]
    mse = (difference**2).mean()
    found = {
        "mse": mse,
        "rmse": np.sqrt(mse),
        "rel_mse": relative.mean(),
        "rel_mse_trimmed": kept.mean(),
        "mape": (np.abs(difference) / (np.abs(reference) + RELATIVE_FLOOR)).mean(),
        "psnr": 10 * np.log10(reference.max() ** 2 / mse) if mse > 0 else None,
        "max_abs": np.abs(difference).max(),
        "flip": flip(picture, reference),
    }
    if stated and not same_seed:
        found["corrected_rmse"] = np.sqrt(max(mse - stated["rmse"] ** 2, 0.0))
        found["corrected_rel_mse"] = max(found["rel_mse"] - stated["rel_mse"], 0.0)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture")
    parser.add_argument("reference")
    parser.add_argument("--coordinator", default="target/release/coordinator")
    args = parser.parse_args()
    command = [args.coordinator, "compare", args.picture, args.reference, "--json"]
    ours = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    (picture, of_picture), (reference, of_reference) = read(args.picture), read(args.reference)
    same_seed = "seed" in of_picture and of_picture["seed"] == of_reference.get("seed")
    worst = 0.0
    for name, value in measures(picture, reference, of_reference.get("error"), same_seed).items():
        mine = ours.get(name)
        if value is None or mine is None:
            print(f"{name:<18}{'-' if mine is None else mine!s:<26}{'-' if value is None else value}: not compared")
            continue
        apart = abs(mine - value) / max(abs(value), 1e-300) if mine != value else 0.0
        worst = max(worst, apart)
        print(f"{name:<18}{mine!s:<26}{value!s:<26}{apart:.1e}")
    print(f"largest relative difference {worst:.1e}, at most {TOLERANCE:.0e} allowed")
    return 0 if worst <= TOLERANCE else 1


if __name__ == "__main__":
    sys.exit(main())
