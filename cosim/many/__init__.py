"""Runs scenes, once or many times: prepared scenes with metrics, one executor of processes, one journal that survives a crash,
variants side by side in vector registers."""
