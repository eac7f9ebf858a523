# colcon's setup.sh reads this, so that `ros2 run agnocast` finds the package.
_colcon_prepend_unique_value AMENT_PREFIX_PATH "$COLCON_CURRENT_PREFIX"
