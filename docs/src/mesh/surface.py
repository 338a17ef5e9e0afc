"""A drawn label volume, and its surface as lobe.ply. Needs numpy and scikit-image."""

import numpy as np
from skimage.measure import label, marching_cubes

# In place of a segmentation, such as np.load("labels.npy"): voxels indexed z, y, x with a number each. 1 is a lobe with a notch,
# 2 a vessel in it, and one voxel is a crumb.
voxel_mm = np.array([3.0, 2.5, 2.5])
z, y, x = np.meshgrid(*[voxel_mm[k] * np.arange(n) for k, n in enumerate((9, 20, 30))], indexing="ij")
inside = ((x - 36) / 34) ** 2 + ((y - 24) / 21) ** 2 + ((z - 12) / 11) ** 2 < 1
notch = (x - 40) ** 2 + (y - 50) ** 2 < 12**2
labels = np.where(inside & ~notch, 1, 0)
labels[inside & (np.hypot(y - 22, z - 12) < 3)] = 2
labels[0, 0, 0] = 1

# All that is tissue, its largest part, and a margin of one voxel, which closes the surface where the volume ends.
parts = label(labels > 0)
mask = np.pad(parts == np.argmax(np.bincount(parts.flat)[1:]) + 1, 1)
points, faces, _, _ = marching_cubes(mask.astype(np.float32), 0.5, spacing=voxel_mm)
# Into x, y, z; the triangles see outwards then. Without the margin's offset, the voxels' own millimetres.
points = (points - voxel_mm)[:, ::-1]

head = f"""ply
format binary_little_endian 1.0
element vertex {len(points)}
property float x
property float y
property float z
element face {len(faces)}
property list uchar int vertex_indices
end_header
"""
rows = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
rows["count"], rows["corners"] = 3, faces
with open("lobe.ply", "wb") as file:
    file.write(head.encode() + points.astype("<f4").tobytes() + rows.tobytes())
print(f"{len(faces)} triangles written to lobe.ply")
