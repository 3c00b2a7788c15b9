def update_direction(*a, **k): raise NotImplementedError
