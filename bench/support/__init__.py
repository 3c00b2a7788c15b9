"""What benchmarks and acceptance tables share: runs of ddic, result files, meshes, cases."""
