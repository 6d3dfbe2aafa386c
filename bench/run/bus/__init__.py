"""The bus: what is opened, read and made safe."""
