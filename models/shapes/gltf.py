"""Write meshes as one glTF 2.0 file with its buffer inside (NumPy only)."""

import base64
import json
from pathlib import Path

import numpy as np
from surface import Mesh

# Base colour (linear, as glTF wants it), roughness, metalness.
MATERIALS = {
    "white": ((0.76, 0.77, 0.78), 0.42, 0.0),
    "dark": ((0.018, 0.019, 0.022), 0.55, 0.0),
    "seam": ((0.11, 0.115, 0.125), 0.6, 0.0),
    "metal": ((0.32, 0.33, 0.35), 0.35, 0.6),
    "light": ((0.08, 0.30, 0.75), 0.4, 0.0),
    "silver": ((0.52, 0.53, 0.54), 0.38, 0.15),
    "orange": ((0.80, 0.16, 0.01), 0.42, 0.0),
    "blue": ((0.16, 0.37, 0.60), 0.45, 0.0),
}


def _joined(meshes: list[Mesh]) -> Mesh:
    faces, start = [], 0
    for vertices, _, triangles in meshes:
        faces.append(triangles + start)
        start += len(vertices)
    vertices, normals = (np.concatenate([m[i] for m in meshes]) for i in (0, 1))
    return vertices, normals, np.concatenate(faces)


def write_gltf(path: Path, parts: list[tuple[str, Mesh]]) -> int:
    """Write parts, each a material and a mesh; return the number of triangles.

    The vertices are in a frame with z up; glTF's y points up, and readers turn it.
    """
    names = list(dict.fromkeys(name for name, _ in parts))
    views, accessors, primitives, blob, triangles = [], [], [], b"", 0

    def add(array: np.ndarray, kind: str, target: int, **more: object) -> int:
        nonlocal blob
        data = array.tobytes()
        views.append(
            {
                "buffer": 0,
                "byteOffset": len(blob),
                "byteLength": len(data),
                "target": target,
            }
        )
        component = {"f4": 5126, "u2": 5123}[array.dtype.str[1:]]
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": component,
                "count": len(array) if kind == "VEC3" else array.size,
                "type": kind,
                **more,
            }
        )
        blob += data + b"\0" * (-len(data) % 4)
        return len(accessors) - 1

    for index, name in enumerate(names):
        vertices, normals, faces = _joined([m for n, m in parts if n == name])
        if len(vertices) > 65535:
            raise ValueError(
                f"{path.name}, {name}: {len(vertices)} vertices, over 65535."
            )
        turned = [0, 2, 1], [1, 1, -1]  # z up to y up
        p = np.round(vertices[:, turned[0]] * turned[1], 6).astype("<f4")
        n = np.round(normals[:, turned[0]] * turned[1], 4).astype("<f4")
        bounds = {"min": p.min(0).tolist(), "max": p.max(0).tolist()}
        primitives.append(
            {
                "attributes": {
                    "POSITION": add(p, "VEC3", 34962, **bounds),
                    "NORMAL": add(n, "VEC3", 34962),
                },
                "indices": add(faces.astype("<u2"), "SCALAR", 34963),
                "material": index,
            }
        )
        triangles += len(faces)
    materials = [
        {
            "name": name,
            "pbrMetallicRoughness": {
                "baseColorFactor": [*MATERIALS[name][0], 1],
                "roughnessFactor": MATERIALS[name][1],
                "metallicFactor": MATERIALS[name][2],
            },
        }
        for name in names
    ]
    uri = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
    text = json.dumps(
        {
            "asset": {"version": "2.0", "generator": "fmp-drake make_meshes.py"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "name": path.stem}],
            "meshes": [{"primitives": primitives, "name": path.stem}],
            "materials": materials,
            "accessors": accessors,
            "bufferViews": views,
            "buffers": [{"byteLength": len(blob), "uri": uri}],
        }
    )
    path.write_text(text + "\n")
    return triangles
