"""File formats of other programs that are not read, with the conversion to a format that is."""

_BLENDER = "open it in Blender and export it by File > Export > glTF 2.0 as .glb"
_IMPORT = "export .glb from Blender (File > Import > {}, then File > Export > glTF 2.0, with its animation)"
_CLOUD = "write it as .ply, by CloudCompare or `pcl_pcd2ply`"
_UNPACK = "unpack it and give the files in it"
_EXPORT = "export its markers as .c3d, or its skeleton as .bvh, from the program that recorded it"
_VIDEO = "no pose is read from pictures; give clouds, meshes, depth as clouds, or markers"

#: images and pages, which are written but never read
PICTURES = (".png", ".jpg", ".jpeg", ".svg", ".html", ".pdf", ".gif", ".webp", ".tif", ".tiff", ".bmp")
#: suffix -> the format to write instead
INSTEAD: dict[str, str] = {
    ".gltf": ".glb, which is the same in one file",
    ".usd": ".usda as text or .usdc packed, which are the same",
    ".fbx": ".glb, which Blender makes an .fbx of",
    ".dae": ".glb, which Blender makes a .dae of",
    ".vrm": ".glb, of which a .vrm is a kind",
    ".amc": ".bvh, which holds a motion with its skeleton",
    ".asf": ".skl, which holds a skeleton",
}
#: suffix -> name of the format, and advice
FOREIGN: dict[str, tuple[str, str]] = {
    ".fbx": ("an FBX file", _IMPORT.format("FBX")),
    ".blend": ("a Blender file", _BLENDER),
    ".dae": ("a Collada file", _IMPORT.format("Collada")),
    ".abc": ("an Alembic file", "in Blender, import it and write each frame as .ply or .obj"),
    ".3ds": ("a 3D Studio file", _BLENDER),
    ".max": ("a file of 3ds Max", "export it as .glb or USD from 3ds Max"),
    ".ma": ("a Maya file", "export it as USD from Maya"),
    ".mb": ("a Maya file", "export it as USD from Maya"),
    ".vrm": ("a VRM file", "this is a .glb under another name: copy it to a name that ends in .glb"),
    ".x3d": ("an X3D file", _IMPORT.format("X3D")),
    ".mvnx": ("a file of Xsens MVN", "export .bvh or .c3d from MVN"),
    ".tak": ("a take of Motive", _EXPORT),
    ".vsk": ("a subject of Vicon", _EXPORT),
    ".x2d": ("raw data of Vicon", _EXPORT),
    ".qtm": ("a file of Qualisys", _EXPORT),
    ".mot": ("a motion of OpenSim", "export the markers as .trc"),
    ".osim": ("a model of OpenSim", "export the markers as .trc"),
    ".pcd": ("a point cloud of PCL", _CLOUD),
    ".las": ("a point cloud of a laser scanner", _CLOUD),
    ".laz": ("a point cloud of a laser scanner", _CLOUD),
    ".e57": ("a point cloud of a laser scanner", _CLOUD),
    ".pts": ("a point cloud as text", _CLOUD),
    ".xyz": ("a point cloud as text", _CLOUD),
    ".npy": ("a single array", "write it as .npz with its name: numpy.savez('clouds.npz', points=array)"),
    ".pkl": ("a pickle", "a pickle can run code, so write its arrays by numpy.savez"),
    ".mat": ("a file of MATLAB", "write its arrays by numpy.savez as .npz"),
    ".h5": ("an HDF5 file", "write its arrays by numpy.savez as .npz"),
    ".hdf5": ("an HDF5 file", "write its arrays by numpy.savez as .npz"),
    ".zip": ("an archive", _UNPACK),
    ".gz": ("an archive", _UNPACK),
    ".7z": ("an archive", _UNPACK),
    ".rar": ("an archive", _UNPACK),
    ".tar": ("an archive", _UNPACK),
    ".bag": ("a recording of ROS", "write its clouds as .ply files"),
    ".mkv": ("a video", _VIDEO),
    ".mp4": ("a video", _VIDEO),
    ".mov": ("a video", _VIDEO),
    ".avi": ("a video", _VIDEO),
    ".exr": ("a picture", _VIDEO),
}
