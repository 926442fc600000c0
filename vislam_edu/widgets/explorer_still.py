def draw(*a): return b'', ''
