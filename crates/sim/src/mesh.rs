//! Triangle meshes from OBJ, STL and PLY files.
