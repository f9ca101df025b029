import java.io.File;
import java.util.List;
import maestro.MaestroCheck;
import maestro.MaestroCheckFMI2;
import maestro.OnFailError;

/** Checks model descriptions by one of VDMCheck2's models, `rules` or `static`, in one process; prints one line a finding. */
public class CheckDescriptions {
    public static void main(String[] arguments) throws Exception {
        for (int i = 1; i < arguments.length; i++) {
            File description = new File(arguments[i]);
            List<OnFailError> errors = arguments[0].equals("rules")
                ? new MaestroCheckFMI2().check(description, null, null)
                : new MaestroCheck().check(description);
            show(arguments[i], errors);
        }
        System.out.println("checked " + (arguments.length - 1));
    }

    private static void show(String name, List<OnFailError> errors) {
        for (OnFailError error : errors) {
            System.out.println(name + "\t" + error.errno + "\t" + error.message.replaceAll("\\s+", " "));
        }
    }
}
