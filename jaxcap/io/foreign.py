"""File formats of other programs that are not read, with the conversion to a format that is."""

_BLENDER = "open it in Blender and export it by File > Export > glTF 2.0 as .glb"
_IMPORT = "export .glb from Blender (File > Import > {}, then File > Export > glTF 2.0, with its animation)"
_CLOUD = "convert it to .ply with CloudCompare"
_UNPACK = "extract it and give the files in it"
_EXPORT = "export its markers as .c3d or its skeleton as .bvh from the program that recorded it"
_VIDEO = "poses are not estimated from colour images; give clouds, meshes, markers, or depth images by `track --depth`"

_CAMERAS = (
    "if it has the intrinsics of a camera, write it as .json with camera_matrix, image_width and image_height "
    "(cv2.FileStorage does so for a name that ends in .json)"
)

#: images and pages, which are written; of these, only depth images and masks are read, by readers of their own
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".svg", ".html", ".pdf", ".gif", ".webp", ".tif", ".tiff", ".bmp")
#: suffix -> the format to write instead
WRITABLE_ALTERNATIVES: dict[str, str] = {
    ".gltf": ".glb, which has the same content in one file",
    ".usd": ".usda (text) or .usdc (binary), which have the same content",
    ".fbx": ".glb, which Blender converts to .fbx",
    ".dae": ".glb, which Blender converts to .dae",
    ".vrm": ".glb, as .vrm is a form of it",
    ".amc": ".bvh, which contains a motion and its skeleton",
    ".asf": ".skl, which contains a skeleton",
}
#: suffix -> name of the format, and advice
UNSUPPORTED_FORMATS: dict[str, tuple[str, str]] = {
    **dict.fromkeys((".yml", ".yaml"), ("a YAML file", _CAMERAS)),
    ".xml": ("an XML file", _CAMERAS),
    ".fbx": ("an FBX file", _IMPORT.format("FBX")),
    ".blend": ("a Blender file", _BLENDER),
    ".dae": ("a Collada file", _IMPORT.format("Collada")),
    ".abc": ("an Alembic file", "in Blender, import it and write each frame as .ply or .obj"),
    ".3ds": ("a 3D Studio file", _BLENDER),
    ".max": ("a 3ds Max file", "export it as .glb or USD from 3ds Max"),
    ".ma": ("a Maya file", "export it as USD from Maya"),
    ".mb": ("a Maya file", "export it as USD from Maya"),
    ".vrm": ("a VRM file", "it has the content of a .glb file: rename a copy of it to .glb"),
    ".x3d": ("an X3D file", _IMPORT.format("X3D")),
    ".mvnx": ("an Xsens MVN file", "export .bvh or .c3d from MVN"),
    ".tak": ("a Motive take", _EXPORT),
    ".vsk": ("a Vicon subject", _EXPORT),
    ".x2d": ("raw Vicon data", _EXPORT),
    ".qtm": ("a Qualisys file", _EXPORT),
    ".las": ("a laser-scanner point cloud", _CLOUD),
    ".laz": ("a laser-scanner point cloud", _CLOUD),
    ".e57": ("a laser-scanner point cloud", _CLOUD),
    ".pts": ("a point cloud as text", _CLOUD),
    ".npy": (
        "a single array",
        "write it as a named array in an .npz: numpy.savez('clouds.npz', points=array)",
    ),
    ".pkl": (
        "a pickle",
        "a pickle can run code, so only body models of SMPL's family are read from it; write other arrays with numpy.savez",
    ),
    ".mat": ("a MATLAB file", "write its arrays as .npz with numpy.savez"),
    ".h5": ("an HDF5 file", "write its arrays as .npz with numpy.savez"),
    ".hdf5": ("an HDF5 file", "write its arrays as .npz with numpy.savez"),
    ".zip": ("an archive", _UNPACK),
    ".gz": ("an archive", _UNPACK),
    ".7z": ("an archive", _UNPACK),
    ".rar": ("an archive", _UNPACK),
    ".tar": ("an archive", _UNPACK),
    ".mp4": ("a video", _VIDEO),
    ".mov": ("a video", _VIDEO),
    ".avi": ("a video", _VIDEO),
}
