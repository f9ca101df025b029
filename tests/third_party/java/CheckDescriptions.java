import java.io.File;
import java.util.List;
import maestro.MaestroCheck;
import maestro.MaestroCheckFMI2;
import maestro.OnFailError;

/**
 * Checks model descriptions by one of VDMCheck2's models, `rules` or `static`, in one process; prints one line a finding, a
 * description that can't be read among them.
 */
public class CheckDescriptions {
    public static void main(String[] arguments) {
        for (int i = 1; i < arguments.length; i++) {
            try {
                show(arguments[i], check(arguments[0], new File(arguments[i])));
            } catch (Exception | Error error) {
                System.out.println(arguments[i] + "\t0\t" + String.valueOf(error).replaceAll("\\s+", " "));
            }
        }
        System.out.println("checked " + (arguments.length - 1));
    }

    private static List<OnFailError> check(String model, File description) throws Exception {
        return model.equals("rules")
            ? new MaestroCheckFMI2().check(description, null, null)
            : new MaestroCheck().check(description);
    }

    private static void show(String name, List<OnFailError> errors) {
        for (OnFailError error : errors) {
            System.out.println(name + "\t" + error.errno + "\t" + error.message.replaceAll("\\s+", " "));
        }
    }
}
