"""The contract between simulation and learning: HDF5 shards, splits, canonical frames and motion windows."""
