"""The reference head drawn by Mitsuba, pyrender and open3d."""
