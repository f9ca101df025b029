"""Natural frequencies with locked motors: along the path, and what leaving out the bending of the distal links does to them.

python frequencies.py
"""

import flexfmu

scene = flexfmu.load_scene("barnard2012-0.1kg")

poses = flexfmu.modes(scene, poses=5)
print("part of the path   first three frequencies [Hz]")
for pose in poses:
    print(f"{pose.s:16.0%}   " + "  ".join(f"{frequency:7.1f}" for frequency in pose.frequencies[:3]))

with_bending = flexfmu.modes(scene.replace({"effects.distal_bending": 3}), poses=3)[1].frequencies
print("middle, with bending of the distal links: " + "  ".join(f"{frequency:.1f}" for frequency in with_bending[:6]))
